"""False stops of a sound rig by its guard, in simulations of plants that differ from the configured model."""

from __future__ import annotations

import argparse
import sys

import numpy as np

from pendulum_env.backends.hardware.config import PlantRanges
from pendulum_env.backends.hardware.plausibility import PlausibilityCheck
from pendulum_env.backends.sensing import COUNTS
from pendulum_env.excitation import EXCITATIONS, excitation
from pendulum_env.physics import BASE, simulate
from pendulum_env.plant import PAPER
from workbench.terminal import Terminal

SPREAD = 0.25  # relative deviation of plants from the configured model
NOISE = {1000.0: 5e-5, 250.0: 5e-5, 100.0: 3e-4}  # uncertainty of a reading's time [s], by rate [Hz]
STEP = 2 * np.pi / COUNTS  # [rad]


def false_stops(samples: int, seed: int = 0) -> tuple[int, int]:
    """Run every excitation at several torques and rates on sound plants; return stops and samples."""
    rng, stops, done, batch, seconds = np.random.default_rng(seed), 0, 0, 8, 20.0
    while done < samples:
        for name in EXCITATIONS:
            for rate, noise in NOISE.items():
                amplitude = float(rng.choice([0.5, 1.0, 1.5, 2.0, 3.5, 5.0, 6.0]))  # the small ones mostly stick
                steps = round(seconds * rate)
                command = excitation(name, rng, seconds, amplitude).signal(np.arange(steps) / rate)
                theta = np.array([*PAPER.values()])[:, None] * rng.uniform(1 - SPREAD, 1 + SPREAD, (len(PAPER), batch))
                way = simulate(BASE, theta, 1.0 / rate, command, rng.uniform(-0.4, 0.4, batch), 0.0)
                read = way.position + way.velocity * rng.normal(0.0, noise, way.position.shape)
                for position in (np.round(read / STEP) * STEP).T:
                    stops += not passes_check(position.tolist(), command.tolist(), rate, noise)
                    done += steps
    return stops, done


def passes_check(position: list[float], command: list[float], rate: float, noise: float) -> bool:
    """Return whether the plausibility check passes a run."""
    watch = PlausibilityCheck(PlantRanges(), STEP, noise)
    watch.check_measurement(0.0, position[0])
    for k, torque in enumerate(command):
        watch.add_command(torque)
        if watch.check_measurement((k + 1) / rate, position[k + 1]):
            return False
    return True


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, default=1_000_000, help="of sound runs")
    arguments = parser.parse_args(sys.argv[1:] if argv is None else argv)
    terminal = Terminal()
    with terminal.progress("sound runs"):
        stops, done = false_stops(arguments.samples)
    terminal.print(f"{stops} false stops in {done:,} samples of sound runs")
    return 0


if __name__ == "__main__":
    sys.exit(main())
