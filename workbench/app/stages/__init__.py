"""Stages in the order of the work; a new one joins by its module and a line here."""

from workbench.app.sessions import Stage
from workbench.app.stages import add, compare, data, diagnose, export, model

STAGES: tuple[Stage, ...] = (
    data.STAGE,
    model.STAGE,
    compare.STAGE,
    diagnose.STAGE,
    add.STAGE,
    export.STAGE,
)

__all__ = ["STAGES"]
