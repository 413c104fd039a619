"""Hide two effects in a pendulum; while it runs, a table names the missing effects, and adds them to the model.

python examples/online_diagnosis.py
"""

import gymnasium as gym
import numpy as np
from rich.live import Live
from rich.table import Table

from estimators.online import OnlineDiagnosis
from estimators.wrappers import DiagnoseOnline
from pendulum_env.excitation import excitation
from pendulum_env.policy import OpenLoop, rollout

HIDDEN = ["cogging:order=12,sin=0.2,cos=0.1", "quadratic_drag:quadratic_drag=0.03"]
SHOWN = 6  # effects in the table
ADDED_FROM = 0.9  # smallest probability of an added effect


def table(time: float, found: OnlineDiagnosis) -> Table:
    """Make a table of the most probable effects, with the gain of each over the running model."""
    model = " + ".join(("base", *found.added))
    verdict = " ".join((found.kind, " or ".join(found.group))).strip()
    title = f"{time:4.1f} s  {model}: {verdict}, error {found.error:.4f} N m"
    rows = Table("effect", "probability", "", r"gain \[nat]", title=title, title_justify="left", min_width=80)
    for one in found.ranking[:SHOWN]:
        bar = "█" * round(20 * one.probability)
        rows.add_row(one.effect, f"{one.probability:.2f}", f"{bar:20}", f"{one.gain:z.0f} ± {one.error:.0f}")
    return rows


def main() -> None:
    """Run for 25 s, and add each missing effect with a high probability."""
    env = gym.make("pendulum_env/DirectDrivePendulum-v0", effects=HIDDEN, torque_noise=0.05, rate=500)
    env = DiagnoseOnline(env)
    signal = OpenLoop(excitation("paper", np.random.default_rng(0)), rate=500.0)
    seen: list[OnlineDiagnosis] = []
    with Live(auto_refresh=False) as live:

        def show(info: dict) -> None:
            found = info["diagnosis"]
            if not seen or found is not seen[-1]:
                if seen and found.added != seen[-1].added:
                    live.console.print(f"{info['time']:4.1f} s  added {found.added[-1]}")
                seen.append(found)
                live.update(table(info["time"], found), refresh=True)
                best = found.ranking[0] if found.ranking else None
                # also where each of two missing effects explains little, so that the verdict is `unexplained`
                if best and best.evidence >= found.threshold and best.probability >= ADDED_FROM:
                    env.add(best.effect)

        rollout(env, signal, steps=12_500, seed=0, watch=show)
    print("\nfound:", ", ".join(seen[-1].added), "| hidden:", ", ".join(effect.partition(":")[0] for effect in HIDDEN))


if __name__ == "__main__":
    main()
