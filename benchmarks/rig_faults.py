"""How soon the guard sees faults of encoder and drive on an emulated rig, and whether it ever stops a sound one."""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import gymnasium as gym
import numpy as np

from benchmarks.rig import start_emulator
from pendulum_env.backends.emulators.motor import MISREADINGS
from pendulum_env.backends.hardware.config import PlantRanges
from pendulum_env.backends.hardware.plausibility import PlausibilityCheck
from pendulum_env.backends.sensing import COUNTS
from pendulum_env.excitation import EXCITATIONS, excitation
from pendulum_env.physics import BASE, simulate
from pendulum_env.plant import PAPER
from pendulum_env.registration import PENDULUM
from workbench.terminal import Terminal

RATE = 500.0  # [Hz]
TORQUES = (0.5, 1.0, 2.0, 3.5, 6.0)  # [N m]
DRIVES = {"gain 3": "gain 3", "gain -1": "gain -1"}
FAULTS = {name: f"encoder {name}" for name in MISREADINGS} | DRIVES
PATIENCE = 1.5  # [s] after which a fault counts as missed
SPREAD = 0.25  # share by which plants differ from what the watch was told
NOISE = {1000.0: 5e-5, 250.0: 5e-5, 100.0: 3e-4}  # uncertainty of a reading's time [s], by rate [Hz]
STEP = 2 * np.pi / COUNTS  # [rad]


def until_stopped(mishap: str, torque: float, seed: int) -> tuple[float, float]:
    """Time from the fault until the guard took the torque away, inf if it did not [s]; how far the arm went [rad]."""
    rng = np.random.default_rng(seed)
    name = list(EXCITATIONS)[seed % len(EXCITATIONS)]
    signal, moment = excitation(name, rng, 10.0, torque).signal, rng.uniform(0.5, 1.5)
    with tempfile.TemporaryDirectory() as folder:
        config, log = Path(folder) / "rig.toml", Path(folder) / "motor.log"
        limits = {"watchdog": 3.0, "gap": 2.25, "reply": 1.5}
        with start_emulator(config, RATE, limits, log=log) as emulator:
            assert emulator.stdin is not None and emulator.stdout is not None
            try:
                emulator.stdout.readline()  # it is ready
                env = gym.make(PENDULUM, backend="dm1015b", config=config, max_episode_steps=-1)
                try:
                    _, info = env.reset()
                    told, positions = False, []
                    while "fault" not in info and info["time"] < moment + PATIENCE:
                        if info["time"] > moment and not told:
                            emulator.stdin.write(mishap + "\n")
                            emulator.stdin.flush()
                            told = True
                        *_, info = env.step(np.array([signal(info["time"])], dtype=np.float32))
                        positions.append(info["position"])
                finally:
                    env.close()
            finally:
                emulator.communicate("quit\n")
        events = [(float(at), event, float(value)) for at, event, value in map(str.split, log.read_text().splitlines())]
    since = [at for at, event, _ in events if event == "mishap"]
    if "fault" not in info:
        return float("inf"), float(np.ptp(positions))
    if not since or (
        "cannot have moved" not in info["fault"] and "encoder" not in info["fault"] and "allowed" not in info["fault"]
    ):
        raise RuntimeError(f"not stopped by the guard's judgement of the motion: {info['fault']}")
    off = [at for at, event, value in events if (event, value) == ("power", 0.0) and at >= since[0]]
    return off[0] - since[0], float(np.ptp(positions))


def patiently(mishap: str, torque: float, seed: int) -> tuple[float, float]:
    """Repeat a run that a busy machine disturbed."""
    for _ in range(2):
        try:
            return until_stopped(mishap, torque, seed)
        except (RuntimeError, ValueError) as error:
            print(f"{mishap}, {torque:g} N m, run {seed}: {error}", file=sys.stderr)
    return until_stopped(mishap, torque, seed)


def false_stops(samples: int, seed: int = 0) -> tuple[int, int]:
    """Run every excitation at several torques and rates on sound plants; return stops and samples."""
    rng, stops, done, batch, seconds = np.random.default_rng(seed), 0, 0, 8, 20.0
    while done < samples:
        for name in EXCITATIONS:
            for rate, noise in NOISE.items():
                amplitude = float(rng.choice([0.5, 1.0, 1.5, 2.0, 3.5, 5.0, 6.0]))  # the first ones mostly stick
                steps = round(seconds * rate)
                command = excitation(name, rng, seconds, amplitude).signal(np.arange(steps) / rate)
                theta = np.array([*PAPER.values()])[:, None] * rng.uniform(1 - SPREAD, 1 + SPREAD, (len(PAPER), batch))
                way = simulate(BASE, theta, 1.0 / rate, command, rng.uniform(-0.4, 0.4, batch), 0.0)
                read = way.position + way.velocity * rng.normal(0.0, noise, way.position.shape)
                for position in (np.round(read / STEP) * STEP).T:
                    stops += not sound(position.tolist(), command.tolist(), rate, noise)
                    done += steps
    return stops, done


def sound(position: list[float], command: list[float], rate: float, noise: float) -> bool:
    """Return whether the watch lets a run pass."""
    watch = PlausibilityCheck(PlantRanges(), STEP, noise)
    watch.check_measurement(0.0, position[0])
    for k, torque in enumerate(command):
        watch.add_command(torque)
        if watch.check_measurement((k + 1) / rate, position[k + 1]):
            return False
    return True


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=5, help="of every fault and torque, one of each excitation")
    parser.add_argument("--samples", type=int, default=1_000_000, help="of sound runs")
    arguments = parser.parse_args(sys.argv[1:] if argv is None else argv)
    terminal = Terminal()
    with terminal.progress("sound runs"):
        stops, done = false_stops(arguments.samples) if arguments.samples else (0, 0)
    terminal.say(f"{stops} false stops in {done:,} samples of sound runs")
    if arguments.runs:
        terminal.heading(f"serial at {RATE:g} Hz: stopped after [s], median and worst; runs that were not stopped")
        table = []
        with terminal.progress("faults") as tell:
            for row, (name, mishap) in enumerate(FAULTS.items()):
                cells = []
                for column, torque in enumerate(TORQUES):
                    tell(f"{name}, {torque:g} N m", (row + column / len(TORQUES)) / len(FAULTS))
                    cells.append(_cell([patiently(mishap, torque, seed) for seed in range(arguments.runs)]))
                table.append((name, *cells))
        terminal.table(("fault", *(f"{torque:g} N m" for torque in TORQUES)), table)
    return 0


def _cell(runs: list[tuple[float, float]]) -> str:
    """Format the share of the runs in which the arm moved."""
    took = np.array([took for took, travel in runs if travel > 0.01 or np.isfinite(took)])
    if not len(took):
        return "at rest"
    seen = took[np.isfinite(took)]
    missed = f"{len(took) - len(seen)} of {len(took)}" if len(seen) < len(took) else ""
    return " ".join([*([f"{np.median(seen):.2f} {seen.max():.2f}"] if len(seen) else []), missed]).strip()


if __name__ == "__main__":
    sys.exit(main())
