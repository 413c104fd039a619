"""Estimate by six schemes while a pendulum runs; it picks up a payload at 10 s, and forgetting follows the change.

python examples/online_estimation.py
"""

import gymnasium as gym
import numpy as np

from estimators.wrappers import EstimateParameters
from pendulum_env.excitation import excitation
from pendulum_env.policy import OpenLoop, rollout

PAYLOAD = "payload_change:moment=10,inertia=0.03,gravity=0.6"


def main() -> None:
    """Print the estimates every 5 s, with two standard errors."""
    env = gym.make("pendulum_env/DirectDrivePendulum-v0", effects=[PAYLOAD], torque_noise=0.02)
    env = EstimateParameters(env, forgetting=0.999)  # remembers about a second
    signal = OpenLoop(excitation("paper", np.random.default_rng(0)), rate=1000.0)

    def report(info: dict) -> None:
        if round(1000 * info["time"]) % 5000 == 0:
            print(f"\n{info['time']:.0f} s {'':16}" + "".join(f"{name:>20}" for name in info["parameters"]))
            for scheme, estimate in info["estimates"].items():
                theta, std = estimate["theta"], estimate["std"]
                numbers = (f"{theta[name]:.4f} +- {2 * std[name]:.4f}" for name in theta)
                print(f"{scheme:21}" + "".join(f"{number:>20}" for number in numbers))

    rollout(env, signal, steps=20_000, seed=0, watch=report)
    print("\ntruth: 0.0895, 2.01, 0.3638, 0.9163; from 10 s on: 0.1195, 2.61, 0.3638, 0.9163")


if __name__ == "__main__":
    main()
