"""The paper's experiment step by step: one run by hand, then twenty with random phases, Table 2 and a page of figures.

python examples/paper_experiment.py [paper.html]

`pendulum-ident paper --report paper.html` does the same from the command line.
"""

import sys

import gymnasium as gym
import numpy as np

from estimators import identify
from estimators.paper import PARAMETERS, PRINTED, TABLE_2, as_logged, paper_experiment
from pendulum_env.excitation import excitation
from pendulum_env.plant import paper_plant
from pendulum_env.policy import OpenLoop, rollout
from workbench.report.paper import write_paper_report


def one_run(seconds: float = 30.0) -> None:
    """Drive the pendulum once, and estimate theta = [I, mgl, b, fc] by all six schemes."""
    rng = np.random.default_rng(0)
    # the dynamic row of Table 2 in pymunk, behind the paper's encoder
    env = gym.make("pendulum_env/DirectDrivePendulum-v0", rate=1000.0, counts=1_024_000, torque_noise=0.02)
    torque = excitation("paper", rng, seconds)  # 3 sin(12.07 t + r1) + 3 sin(2.25 t + r2), section 6
    recording = rollout(env, OpenLoop(torque, rate=1000.0), steps=round(1000 * seconds), seed=0)

    ours = identify([recording])  # clear of stick, torque as it was held, derivatives without delay
    printed = identify([recording], schemes=PRINTED, measured=lambda run: [as_logged(run)])  # (7), (8), (9)
    print("true theta           ", paper_plant().theta)
    for scheme in TABLE_2:
        print(f"{scheme:21}", ours[scheme].model.theta.round(4), "as printed", printed[scheme].model.theta.round(4))

    # Figure 6: how the recursion (6) of the Hamiltonian scheme settles, from theta(0) = 0 and P(0) = 1e7
    course = ours["hamiltonian"].convergence
    for second in (1, 3, 10):
        k = np.searchsorted(course.time, second)
        print(f"hamiltonian, {second:2} s    ", course.theta[k].round(4), "+-", course.std[k].round(4))


def twenty_runs(page: str) -> None:
    """Repeat it with random phases: errors of every scheme, and the page with Table 2 and figures 2 to 9."""
    experiment = paper_experiment(runs=20, progress=lambda what, share: print(f"\r{what}   ", end="", file=sys.stderr))
    print(f"\nmedian (worst) error in % over {experiment.runs} runs of", *PARAMETERS)
    for scheme in TABLE_2:
        for way in ("ours", "printed"):
            _, median, worst = experiment.score(way, scheme)
            errors = (f"{100 * m:.2g} ({100 * w:.2g})" for m, w in zip(median, worst, strict=True))
            print(f"{scheme:21} {way:8}", *(f"{error:17}" for error in errors))
    print("hamiltonian differs from dynamic, given its inertia, by", experiment.disagreement("hamiltonian"))
    write_paper_report(page, experiment)
    print("wrote", page)


if __name__ == "__main__":
    one_run()
    twenty_runs(sys.argv[1] if len(sys.argv) > 1 else "paper.html")
