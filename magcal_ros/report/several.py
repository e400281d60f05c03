"""The section of a report on turns that were put together."""

from __future__ import annotations

from html import escape

from magcal_ros.core.several.result import Several


def several_section(several: Several) -> str:
    """Return what became of each turn, what is shown, and what the next should be."""
    rows = "".join(
        f"<tr><td>{escape(fate.name)}</td><td>{'joined' if fate.joined else 'left out'}</td>"
        f"<td>{escape(fate.words)}</td></tr>"
        for fate in several.fates
    )
    return (
        '<section id="several"><h2>Turns put together</h2>'
        '<table class="checks"><tr><th>turn</th><th>fate</th><th>what it shows</th></tr>'
        f"{rows}</table>"
        f"<p>Now shown: {escape(several.shown.in_words)}.</p>"
        f"<p>{escape(several.advice_in_words)}</p></section>"
    )
