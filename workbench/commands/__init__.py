"""The commands in the order of a first visit."""

from workbench.command import Command
from workbench.commands import (
    add,
    app,
    compare,
    demo,
    diagnose,
    effects,
    emulate,
    evaluate,
    hardware,
    identify,
    paper,
    record,
    train,
)

COMMANDS: dict[str, Command] = {
    "demo": demo.COMMAND,
    "record": record.COMMAND,
    "identify": identify.COMMAND,
    "compare": compare.COMMAND,
    "diagnose": diagnose.COMMAND,
    "add": add.COMMAND,
    "effects": effects.COMMAND,
    "paper": paper.COMMAND,
    "hardware": hardware.COMMAND,
    "emulate": emulate.COMMAND,
    "train": train.COMMAND,
    "evaluate": evaluate.COMMAND,
    "app": app.COMMAND,
}

__all__ = ["COMMANDS"]
