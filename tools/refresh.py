"""Update the outputs shown in README and docs/: python -m tools.refresh [PAGE ...].

Outputs that are still printed stay unchanged. In other outputs, each shown line is replaced by the next printed line
that differs only in numbers, or else by the most similar later line. Omitted lines stay omitted. A line without a
similar one stays and is reported, for a change by hand.
"""

import difflib
import sys
import tempfile
from pathlib import Path

from tools.prose import (
    PAGES,
    README,
    candidates,
    find_missing_line,
    is_left_out,
    isolated_folder,
    outputs,
    read_runnable_blocks,
)


def update_output(shown: str, printed: str) -> tuple[str, list[str]]:
    """Return the new text of an output, and its lines without a replacement."""
    if find_missing_line(shown, printed) is None:
        return shown, []
    lines, gone, place = [], [], 0
    for line in shown.splitlines():
        new, after = line, place
        if not is_left_out(line):
            indent = line[: len(line) - len(line.lstrip())]
            if found := next(candidates(line, printed, place), None):
                new, after = indent + found[0], found.end()
            elif alike := difflib.get_close_matches(line, printed[place:].splitlines(), n=1):
                new, after = alike[0].rstrip(), printed.index(alike[0], place) + len(alike[0])
            else:
                gone.append(line)
        lines.append(new)
        place = after
    return "".join(line + "\n" for line in lines), gone


def refresh(path: Path) -> list[str]:
    """Run a page and rewrite its stale outputs; return the lines to change by hand."""
    page, shift, to_do = path.read_text(encoding="utf-8"), 0, []
    for output in outputs(path, read_runnable_blocks(path)):
        new, gone = update_output(output.shown, output.printed)
        start = output.start + shift
        page = page[:start] + new + page[start + len(output.shown) :]
        shift += len(new) - len(output.shown)
        to_do += [f"{output.where}: is not printed any more: {line}" for line in gone]
    path.write_text(page, encoding="utf-8")
    return to_do


if __name__ == "__main__":
    to_do = []
    for path in [Path(name).resolve() for name in sys.argv[1:]] or [README, *PAGES]:
        print(f"running {path.name}", flush=True)
        with tempfile.TemporaryDirectory() as folder, isolated_folder(Path(folder)):
            to_do += refresh(path)
    sys.exit("\n".join(to_do) or None)
