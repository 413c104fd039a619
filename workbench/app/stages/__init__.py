"""Stages in their order on the page; to add one, write its module and extend `STAGES`."""

from workbench.app.parts import Stage
from workbench.app.stages import add, data, diagnose, export, model

STAGES: tuple[Stage, ...] = (data.STAGE, model.MODEL, model.COMPARE, diagnose.STAGE, add.STAGE, export.STAGE)

__all__ = ["STAGES"]
