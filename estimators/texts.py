"""Texts of findings of other packages than the workbench, registered by the entry points `TEXTS`."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from estimators.findings import Finding
from pendulum_env.plugins import load_plugins

TEXTS = "pendulum_ident.texts"  # entry points of objects `FindingTexts`
Text = str | Callable[[Any], str]  # template with fields of a finding, `{mass:3}`, or function of the finding
Key = type[Finding] | str  # class of findings, or action of a `Treatment`


@dataclass(frozen=True)
class FindingTexts:
    """Texts of an installed package on its findings.

    A template has fields of the finding in braces: a quantity in its displayed unit (`{angle:3}` with three digits),
    names as a list in words.

    Attributes:
        findings: sentences on findings; for the reason of a verdict, a phrase about the effect.
        causes: phrases on findings that are a missing part of the machine, as "a payload of 2 kg", for the result of a
            diagnosis.
    """

    findings: Mapping[Key, Text]
    causes: Mapping[type[Finding], Text] = field(default_factory=dict)


def find_text(key: Key) -> Text | None:
    """Find the text of an installed package on a class of findings or an action; None without one."""
    return next((texts.findings[key] for texts in _list_texts() if key in texts.findings), None)


def find_cause(kind: type[Finding]) -> Text | None:
    """Find the phrase of an installed package on a missing part of the machine; None without one."""
    return next((texts.causes[kind] for texts in _list_texts() if kind in texts.causes), None)


def _list_texts() -> Iterator[FindingTexts]:
    """Yield the texts of installed packages, in the order of their entry points."""
    return (texts for texts in load_plugins(TEXTS).values() if isinstance(texts, FindingTexts))
