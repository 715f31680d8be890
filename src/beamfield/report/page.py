"""The parts that pages are made of: the document around them, verdicts, findings, tables and figures."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from importlib.resources import files

from beamfield.finding import Finding, Severity
from beamfield.report.escape import escaped
from beamfield.report.page_section import Level
from beamfield.report.panel import ReportFigure

# Colours alone tell nothing to many readers: each box begins with its word.
LEVELS: Mapping[Level, str] = {"good": "Good", "care": "Use with care", "bad": "Do not trust"}
SEVERITIES: Mapping[Severity, str] = {"error": "Error", "warning": "Warning", "info": "Note"}


def document(
    title: str, main: str, contents: Iterable[tuple[str, str]], footer: str, figures: Iterable[ReportFigure] = ()
) -> str:
    """Return a page that needs nothing else: no script, no network, no other file.

    The title, of the browser's window, and the footer are plain text, the main part is HTML; contents are anchor and
    name of each part. Figures are named in them, below the part "figures", where there is room.
    """
    style = files(__package__).joinpath("page.css").read_text(encoding="utf-8")
    more = "".join(f'<li class="more"><a href="#{part.name}">{escaped(part.title)}</a></li>' for part in figures)
    links = "".join(
        f'<li><a href="#{anchor}">{escaped(name)}</a></li>{more if anchor == "figures" else ""}'
        for anchor, name in contents
    )
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<meta name="color-scheme" content="light dark">\n'
        f"<title>{escaped(title)}</title>\n<style>{style}</style>\n</head>\n<body>\n"
        f'<a class="skip" href="#main">Skip to the result</a>\n<nav aria-label="Contents"><ul>{links}</ul></nav>\n'
        f'<main id="main">\n{main}\n<footer>{escaped(footer)}</footer>\n</main>\n</body>\n</html>\n'
    )


def verdict_box(level: Level, text: str, word: str = "") -> str:
    """Return the answer in a box of its level's colour, which begins with a word, the level's if it is empty."""
    said = escaped(text).replace(" -&gt; ", "\N{NO-BREAK SPACE}→\N{NO-BREAK SPACE}")
    return f'<p class="verdict {level}"><b class="label">{word or LEVELS[level]}</b> {said}</p>'


def finding_list(findings: Iterable[Finding]) -> str:
    """Return findings, each with what was seen, why it matters and what to do."""
    items = "\n".join(map(_finding, findings))
    return f'<ul class="findings">\n{items}\n</ul>'


def _finding(finding: Finding) -> str:
    why = f"\n<p>{escaped(finding.why)}</p>" if finding.why else ""
    do = f'\n<p class="do"><b>What to do:</b> {escaped(finding.do)}</p>' if finding.do else ""
    return (
        f'<li class="{finding.severity}"><p><b class="label">{SEVERITIES[finding.severity]}</b> '
        f"{escaped(finding.text)} <code>{escaped(finding.name)}</code></p>{why}{do}</li>"
    )


def fold(title: str, markup: str, anchor: str = "") -> str:
    """Return a part of the page that a click unfolds: its title, plain text, and the HTML below it."""
    # A link to what lies inside unfolds it, a link to the fold itself would not.
    inside = f'<div id="{anchor}">\n{markup}\n</div>' if anchor else markup
    return f'<details class="fold"><summary><h3>{escaped(title)}</h3></summary>\n{inside}\n</details>'


def table(
    header: Sequence[str],
    rows: Iterable[Sequence[object]],
    *,
    right: Collection[int] = (),
    bold: Collection[int] = (),
    css: str = "",
) -> str:
    """Return a table whose first column heads its rows, with cells of plain text.

    The header is empty for a table without. `right` are columns that are aligned to the right, `bold` rows that stand
    out; `css` is the table's class.
    """

    def cell(tag: str, i: int, value: object) -> str:
        kind = ' class="n"' if i in right else ""
        return f"<{tag}{kind}>{escaped(value)}</{tag.split()[0]}>"

    head = "".join(cell('th scope="col"', i, name) for i, name in enumerate(header))
    body = ""
    for number, row in enumerate(rows):
        cells = "".join(cell("td" if i else 'th scope="row"', i, value) for i, value in enumerate(row))
        body += f'<tr class="fit">{cells}</tr>\n' if number in bold else f"<tr>{cells}</tr>\n"
    thead = f"<thead><tr>{head}</tr></thead>\n" if head else ""
    kind = f' class="{css}"' if css else ""
    return f'<div class="scroll"><table{kind}>{thead}<tbody>{body}</tbody></table></div>'


def figure(drawn: ReportFigure, *, folded: bool = False) -> str:
    """Return a figure with its caption, whose pictures a click enlarges; without pictures, the caption alone.

    A folded one shows its title until a click unfolds it.
    """
    # A checkbox needs no script, and is reached by keys.
    box = f'<input type="checkbox" aria-label="Enlarge: {escaped(drawn.title)}">'
    panels = "\n".join(
        f'<div class="{"wide" if panel.wide else "narrow"}"><label class="zoom" title="Click to enlarge">{box}'
        f'<span class="picture">{panel.markup}</span></label></div>'
        for panel in drawn.panels
    )
    pictures = f'<div class="panels">{panels}</div>\n' if panels else ""
    source = f' <span class="source">[{escaped(drawn.source)}]</span>' if drawn.source else ""
    head = "" if folded else f"<h3>{escaped(drawn.title)}</h3>\n"
    markup = (
        f'<figure id="{drawn.name}">\n{head}{pictures}'
        f"<figcaption>{escaped(drawn.caption)}{source}</figcaption>\n</figure>"
    )
    return fold(drawn.title, markup) if folded else markup
