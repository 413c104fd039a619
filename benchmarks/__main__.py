"""`python -m benchmarks`: list the benchmarks, then run the short ones."""

from __future__ import annotations

import importlib
import sys

from workbench.terminal import Terminal

SHORT = (  # five minutes on two cores
    ("environments", ()),
    ("policies", ()),
    ("hidden_effects", ("--n", "24")),
)
COMMANDS = (
    "environments", "joint_state", "online_diagnosis", "hidden_effects", "known_truth",
    "cramer_rao", "ambiguity", "arm_excitation", "mujoco_plant", "multisine", "rig", "rig_faults",
    "late_torque", "retold", "servos", "policies", "six_joint", "survey", "sysid", "timing", "user_logs",
)  # fmt: skip


def main() -> int:
    terminal = Terminal()
    modules = {name: importlib.import_module(f"benchmarks.{name}") for name in COMMANDS}
    terminal.print_heading("Benchmarks")
    rows = [
        (f"python -m benchmarks.{name}", str(module.__doc__).partition("\n")[0]) for name, module in modules.items()
    ]
    terminal.print_table(("command", "what it prints"), rows, left=("what it prints",))
    for name, arguments in SHORT:
        terminal.print_heading(" ".join([f"python -m benchmarks.{name}", *arguments]))
        code: int = modules[name].main(arguments)
        if code:
            return code
    return 0


if __name__ == "__main__":
    sys.exit(main())
