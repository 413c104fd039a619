"""Laws of terms as MathML, which browsers draw without scripts."""

import re
from html import escape

PRODUCTS = {"Nq": "N q", "dI": "Δ I", "dmgl": "Δ m g l", "dt": "d t", "mgl": "m g l", "wt": "ω t"}
GREEK = {"integral": "∫", "lambda": "λ", "mu": "μ", "tau": "τ"}
FUNCTIONS = ("cos", "exp", "sgn", "sin", "tanh")
WORDS = ("of", "or")  # other words have more letters than a symbol with its index
SYMBOL = re.compile(r"([A-Za-z]|mu|tau)_?([0-9a-z])")  # letter and index: fs, tau_a
DOTS = ("", "˙", "¨")  # of derivatives, by the number of primes
OPEN, CLOSE = '<mo stretchy="false">(</mo>', '<mo stretchy="false">)</mo>'
TOKEN = re.compile(r"(?P<name>[A-Za-z]+(?:_[a-z]|[0-9])?)(?P<primes>'*)|(?P<number>[0-9.]+)|(?P<sign>>=|<=|\+-|\S)")


def format_law(law: str) -> str:
    """Return a law such as `fs exp(-|q'/vs|^n) sgn q'` as MathML; words in it stay text."""
    tokens, groups = list(TOKEN.finditer(law)), list[list[str]]([[]])
    is_power = False
    for token in tokens:
        if token["sign"] == "^":
            is_power = True
            continue
        if token["sign"] == "(":
            groups.append(["^"] if is_power else [])  # the group that it raises is not closed yet
            is_power = False
            continue
        item = _format_token(token)
        if token["sign"] == ")" and len(groups) > 1:
            group = groups.pop()
            is_power = group[:1] == ["^"]
            item = _join(group[1:] if is_power else [OPEN, *group, CLOSE])
        if is_power and groups[-1]:
            item, is_power = f"<msup>{groups[-1].pop()}{item}</msup>", False
        groups[-1].append(item)
    return f'<math class="law">{"".join(part for group in groups for part in group if part != "^")}</math>'


def _join(items: list[str]) -> str:
    return f"<mrow>{''.join(items)}</mrow>"


def _format_token(token: re.Match[str]) -> str:
    """Return a name with its index and dots, a number or a sign as MathML."""
    name, dot = token["name"], DOTS[min(len(token["primes"] or ""), 2)]
    if name is None:
        if token["number"]:
            return f"<mn>{token['number']}</mn>"
        sign = {">=": "≥", "<=": "≤", "-": "−", "+-": "±"}.get(token["sign"], token["sign"])
        tight = ' stretchy="false" lspace="0" rspace="0"' if sign in "|/" else ""
        return f"<mo{tight}>{escape(sign)}</mo>"
    if name in PRODUCTS:
        return _join([f"<mi>{factor}</mi>" for factor in PRODUCTS[name].split()])
    if name in FUNCTIONS:
        return f'<mo lspace="0.17em" rspace="0.17em">{name}</mo>'
    if len(name) == 1 or name in GREEK:
        return _add_dot(f"<mi>{GREEK.get(name, name)}</mi>", dot)
    if (symbol := SYMBOL.fullmatch(name)) and name not in WORDS:
        letter, index = GREEK.get(symbol[1], symbol[1]), symbol[2]
        return f'<msub>{_add_dot(f"<mi>{letter}</mi>", dot)}<mi mathvariant="normal">{index}</mi></msub>'
    return f"<mtext>&#8197;{escape(name)}&#8197;</mtext>"


def _add_dot(item: str, dot: str) -> str:
    return f'<mover accent="false">{item}<mo>{dot}</mo></mover>' if dot else item
