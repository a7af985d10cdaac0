"""A table of text, for the terminal and for a document."""

from dataclasses import dataclass

from rich.markup import escape
from rich.table import Table

_SHORT_NAME = 24
"""A name of so many letters stays on one line."""


@dataclass(frozen=True, slots=True)
class PlainTable:
    """A table, not yet drawn; the first column holds names, the others numbers."""

    title: str
    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def drawn(self) -> Table:
        """For the terminal."""
        table = Table(title=self.title)
        are_short = all(len(row[0]) <= _SHORT_NAME for row in self.rows)
        for index, heading in enumerate(self.headings):
            table.add_column(
                heading,
                justify="right" if index else "left",
                no_wrap=not index and are_short,
                min_width=max(map(len, heading.split())),
            )
        for row in self.rows:
            table.add_row(*(escape(cell) for cell in row))
        return table

    def as_markdown(self) -> str:
        """For a document."""
        rule = ("---", *("---:" for _ in self.headings[1:]))
        lines = [f"| {' | '.join(row)} |" for row in (self.headings, rule, *self.rows)]
        return "\n".join([f"## {self.title}", "", *lines, ""])
