"""Stages in the order of the work; a new one joins by its module and a line here."""

from workbench.app.parts import Stage
from workbench.app.stages import add, data, diagnose, export, model

STAGES: tuple[Stage, ...] = (
    data.STAGE,
    model.MODEL,
    model.COMPARE,
    diagnose.STAGE,
    add.STAGE,
    export.STAGE,
)

__all__ = ["STAGES"]
