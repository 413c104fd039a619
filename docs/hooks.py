"""Hooks of MkDocs: pages generated from the code, and equations as MathML."""

from __future__ import annotations

import contextlib
import functools
import html
import importlib
import inspect
import io
import json
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

from estimators.schemes.six import SCHEMES
from pendulum_env.formatting import capitalise, join_words
from pendulum_env.mathml import format_law
from pendulum_env.physics import BASE, effects, list_nameable
from pendulum_env.physics.description import Symptom
from pendulum_env.physics.effect_texts import find_description, find_look_alikes, name_effect
from workbench.cli import COMMANDS, main
from workbench.commands.effects import list_parameters

ROOT = Path(__file__).parents[1]
WIDTH = "84"  # characters of a line of help
NOTEBOOK = re.compile(r"\]\((?:\.\./)?((?:\.\./)*)examples/(\w+)\.ipynb")
CONTRIBUTING = re.compile(r"\]\((?:\.\./)((?:\.\./)*)CONTRIBUTING\.md")
MODULE = re.compile(r"\]\((?:\.\./)((?:\.\./)*)((?:pendulum_env|estimators|agents|robots|workbench)/[\w/]+)\.py")
ARITHMATEX = re.compile(r'<(?P<tag>span|div) class="arithmatex">(?P<latex>.*?)</(?P=tag)>', re.S)


@dataclass(frozen=True)
class Reference:
    """Page on the public classes and functions of packages, and on further classes of their results."""

    title: str
    text: str
    packages: tuple[str, ...]
    further: tuple[str, ...] = ()

    @property
    def functions(self) -> list[Any]:
        """Public functions of the packages."""
        return [item for item in self._list_public() if inspect.isroutine(item)]

    def _list_public(self) -> list[Any]:
        modules = [importlib.import_module(package) for package in self.packages]
        return [getattr(module, name) for module in modules for name in module.__all__]

    def list_names(self) -> list[str]:
        """Return the full names of the functions and classes, functions first."""
        classes = filter(inspect.isclass, self._list_public())
        names = [f"{item.__module__}.{item.__name__}" for item in (*self.functions, *classes)]
        return list(dict.fromkeys([*names, *self.further]))

    def markdown(self) -> str:
        """Return the page with directives, which mkdocstrings replaces by docstrings."""
        links = [f"[`{f.__name__}`][{f.__module__}.{f.__name__}]" for f in self.functions]
        first = [f"Functions: {', '.join(links)}. Classes of arguments and results follow them.", ""] if links else []
        return "\n".join([f"# {self.title}", "", self.text, "", *first, *(f"::: {name}" for name in self.list_names())])


REFERENCES = {
    "estimators": Reference(
        "Identify, compare, diagnose",
        "Arguments are models and results first, then recordings, and paths last. A recording is an object or a path, "
        "alone or in a list; a term or a scheme is an object or an id. Results have "
        "[`recordings`](../how-to/results.md) with arrays, and `json()` with plain dictionaries.",
        ("estimators", "workbench.report", "workbench.export"),
        (
            "estimators.schemes.fitting.Identified",
            "estimators.schemes.fitting.Convergence",
            "estimators.results.RecordingErrors",
            "estimators.signals.residual.Region",
            "estimators.diagnosis.result.Step",
            "estimators.diagnosis.result.Candidate",
            "estimators.decisions.errors.Errors",
            "estimators.decisions.gate.Gate",
            "estimators.diagnosis.suggestion.Suggestion",
            "estimators.checks.alignment.Alignment",
            "estimators.checks.homogeneity.Disagreement",
            "estimators.findings.Finding",
            "pendulum_env.quantity.Quantity",
            "workbench.survey.run.run_survey",
            "workbench.survey.recordings.find_recordings",
            "workbench.survey.diagnosis.hash_content",
            "workbench.survey.diagnosis.diagnose_source",
            "workbench.survey.table.find_series",
            "estimators.trends.fit_trend",
        ),
    ),
    "online": Reference("Estimate online", "", ("estimators.wrappers", "estimators.online")),
    "physics": Reference(
        "Physics and models",
        "",
        ("pendulum_env.physics",),
        ("pendulum_env.plant.make_plant", "pendulum_env.plant.hide"),
    ),
    "recordings": Reference(
        "Recordings and excitation",
        "",
        ("pendulum_env.recording",),
        (
            "robots.servos.drive.ServoDrive",
            "pendulum_env.excitation.excitation",
            "pendulum_env.excitation.Excitation",
            "pendulum_env.policy.OpenLoop",
            "pendulum_env.policy.rollout",
        ),
    ),
    "environment": Reference(
        "Environment and backends",
        "",
        ("pendulum_env.wrappers", "pendulum_env.backends"),
        (
            "pendulum_env.env.DirectDrivePendulum",
            "pendulum_env.vector_env.DirectDrivePendulumVector",
            "robots.arms.env.PlanarArm",
            "pendulum_env.backends.hardware.adapter.Adapter",
            "pendulum_env.backends.hardware.adapter.Reading",
            "pendulum_env.backends.hardware.adapter.Sent",
            "pendulum_env.backends.hardware.adapter.driver_errors",
        ),
    ),
    "agents": Reference(
        "Excitation by an agent",
        "",
        ("agents",),
        (
            "agents.evaluation.Outcome",
            "agents.design_env.ExcitationDesign",
            "agents.design_env.ExcitationDesignVector",
            "robots.arms.design_env.ArmExcitationDesign",
            "robots.arms.design_env.ArmExcitationDesignVector",
            "robots.arms.design_env.plan_motion",
            "agents.config.Config",
            "agents.baselines.make_baseline",
            "agents.vec_env.BatchedVecEnv",
        ),
    ),
    "arms": Reference(
        "Arms",
        "`identify`, `compare`, `diagnose` and `add` are [those of a pendulum](estimators.md).",
        ("robots.arms",),
    ),
}


def on_files(files: Files, config: MkDocsConfig) -> None:
    """Add the generated pages."""
    made = {
        "overview.md": from_root("README.md"),
        "contributing.md": from_root("CONTRIBUTING.md"),
        "security.md": from_root("SECURITY.md"),
        "changelog.md": from_root("CHANGELOG.md"),
        "tutorial.md": notebook("tutorial"),
        "paper.md": notebook("paper"),
        "reinforcement_learning.md": notebook("reinforcement_learning"),
        "reference/command-line.md": command_line(),
        "which-effect.md": which_effect(),
        "reference/effects.md": effects_page(),
        "reference/schemes.md": schemes_page(),
        **{f"reference/{name}.md": page.markdown() for name, page in REFERENCES.items()},
    }
    for path, content in made.items():
        files.append(File.generated(config, path, content=content))


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Replace links to notebooks, modules and CONTRIBUTING.md, which a checkout shows, by links to their pages."""
    markdown = NOTEBOOK.sub(r"](\1\2.md", markdown)
    markdown = CONTRIBUTING.sub(r"](\1contributing.md", markdown)
    return MODULE.sub(lambda found: f"]({found[1]}reference/{find_reference(found[2])}.md", markdown)


@functools.cache
def find_reference(path: str) -> str:
    """Find the page of a module or package, by its path without suffix; raises ValueError if no page has it."""
    module = path.replace("/", ".").removesuffix(".__init__")
    for name, page in REFERENCES.items():
        if module in page.packages or any(full.startswith(f"{module}.") for full in page.list_names()):
            return name
    raise ValueError(f"no page of the reference has the module {module}: link another one")


def on_page_content(content: str, **_: Any) -> str:
    """Convert LaTeX to MathML, which browsers draw without scripts."""

    def mathml(found: re.Match[str]) -> str:
        display = "block" if found["tag"] == "div" else "inline"
        return convert(html.unescape(found["latex"]).strip()[2:-2].strip(), display=display)

    return ARITHMATEX.sub(mathml, content)


def from_root(name: str) -> str:
    """Make a page of a file outside docs/, with its links and pictures relative to docs/."""
    page = (ROOT / name).read_text(encoding="utf-8").replace("](docs/", "](").replace('src="docs/', 'src="')
    page = page.replace("](README.md", "](overview.md")
    return re.sub(r"\]\((CONTRIBUTING|SECURITY|CHANGELOG)\.md", lambda found: found[0].lower(), page)


def notebook(name: str) -> str:
    """Make a page of a notebook with its stored outputs, which a test compares with fresh ones."""
    cells = json.loads((ROOT / "examples" / f"{name}.ipynb").read_text(encoding="utf-8"))["cells"]
    parts = [part for cell in cells for part in _cell(cell)]
    parts.insert(
        1, f'!!! note ""\n    This page is the notebook `examples/{name}.ipynb`, with what came out when it ran.'
    )
    return "\n\n".join(parts)


def _cell(cell: dict[str, Any]) -> Iterator[str]:
    source = "".join(cell["source"])
    if cell["cell_type"] == "markdown":
        yield source.replace("](../docs/", "](")
        return
    yield f"```python\n{source}\n```"
    for output in cell["outputs"]:
        if "text/html" in output.get("data", {}):
            yield f'<div class="output">{"".join(output["data"]["text/html"])}</div>'
        elif "text" in output:
            yield f"```text\n{''.join(output['text'])}\n```"


def command_line() -> str:
    """Make the page with the output of `--help` of every command."""
    parts = [
        "# Command line",
        "Every command exits with 0 on success, and with 2 and one line of explanation on bad input.",
        f"```text\n{_help()}\n```",
    ]
    for command, text in COMMANDS.items():
        summary = text[:1].upper() + text[1:]
        parts += [f"## {command}", f"{summary}.", f"```text\n{_help(command)}\n```"]
    return "\n\n".join(parts)


def _help(*command: str) -> str:
    width = os.environ.get("COLUMNS")
    os.environ["COLUMNS"] = WIDTH
    try:
        with contextlib.redirect_stdout(io.StringIO()) as out:
            main([*command, "--help"])
    finally:
        os.environ.pop("COLUMNS") if width is None else os.environ.update(COLUMNS=width)
    return out.getvalue().strip()


def effects_page() -> str:
    """Make the page on the library of effects."""
    parts = [
        "# Effects",
        f"The model is torque = {_law(' + '.join(term.law for term in BASE))}, and any of "
        f"{len(list_nameable())} effects. "
        "Each law is added to that side of the balance unless it says otherwise. Your own effect is "
        "[a few lines of Python](../how-to/effect.md).",
        "| effect | kind | law |\n|---|---|---|",
    ]
    parts[-1] += "".join(
        f"\n| [`{id}`](#{id}) | {kind.kind} | {_law(kind.law)} |" for id, kind in list_nameable().items()
    )
    for id, kind in list_nameable().items():
        looks = f" [How it looks](../which-effect.md#{id})." if id in effects() else ""
        parts += [
            f"## `{id}` {{ #{id} }}",
            _law(kind.law),
            _prose(kind),
            f"Parameters, of a size that a rig might show: {list_parameters(kind)}.",
            f"To show it, a recording needs {find_description(id).informative_experiment}.{looks}",
        ]
    return "\n\n".join(parts)


def which_effect() -> str:
    """Make the page on the symptoms of each effect and its look-alikes; `make pages` draws the pictures."""
    library = effects()
    texts = {id: find_description(id) for id in library}
    rows = {
        symptom: [_link(id) for id, text in texts.items() if text.symptom == symptom] for symptom in get_args(Symptom)
    }
    parts = [
        "# Which effect is it?",
        "The shape of the residual torque shows which physical effect a model lacks. `pendulum-ident diagnose` decides "
        "by numbers. `pendulum-ident effects stribeck` prints the text of one effect.",
        "| the residual shows | possible effects |\n|---|---|",
        "The pictures show the residual of the base model without each effect, fitted to 20 s of the paper's "
        "excitation: mean residual torque over angle, velocity, torque and time, and the band of noise (grey, 5σ). The "
        "[app](app.md) and `pendulum-ident compare --report` draw the same four curves for your recordings. An effect "
        "that looks flat here needs another motion. A motor that turns with two joints of an arm causes "
        "friction of the sum of their speeds, [a coupling](robots/arms.md#diagnose). A residual that no "
        "effect explains can be [modelled by a table](how-to/unknown-law.md).",
    ]
    parts[2] += "".join(f"\n| {symptom} | {', '.join(ids)} |" for symptom, ids in rows.items())
    for id, kind in library.items():
        parts += [
            f"## {capitalise(name_effect(id))} {{ #{id} }}",
            f"![Residual over angle, velocity, torque and time where {id} is hidden](gallery/{id}.svg)",
            texts[id].signature,
            f"Confused with {join_words([_link(other) for other in find_look_alikes(id)])}. "
            f"Distinguished by {texts[id].informative_experiment}. "
            f"Law: {_law(kind.law)} ([`{id}`](reference/effects.md#{id})).",
        ]
    return "\n\n".join(parts)


def _link(id: str) -> str:
    return f"[{name_effect(id)}](#{id})" if id in effects() else name_effect(id)


def schemes_page() -> str:
    """Make the page on the six schemes."""
    parts = [
        "# Schemes",
        "All six are derived on the page on [theory](../theory.md). On the command line and in Python they go by their "
        'ids; with options of their own they are `scheme("filtered_power", operator=LowPass(100.0))` and the like, of '
        "`estimators.schemes`. E is the stored energy, p = I q' the momentum, and F = lambda / (s + lambda) a low-pass "
        "filter.",
    ]
    for scheme in SCHEMES:
        parts += [f"## `{scheme.id}` {{ #{scheme.id} }}", _law(scheme.balance), f"Unit of the residual: {scheme.unit}."]
    return "\n\n".join(parts)


def _law(text: str) -> str:
    return format_law(text).replace("|", "&#124;")  # a bar would end a cell of a table


def _prose(kind: type[Any]) -> str:
    """Convert the docstring of a class to Markdown, with stars and underscores of laws escaped."""
    text = (kind.__doc__ or "").strip()
    paragraphs = [" ".join(line.strip() for line in part.splitlines()) for part in text.split("\n\n")]
    return "\n\n".join(re.sub(r"([*_<|])", r"\\\1", paragraph) for paragraph in paragraphs)
