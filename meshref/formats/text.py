"""Parts that the readers share: words of a text by lines, and numbers among them."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from meshref.topology import FloatArray


class DamageError(Exception):
    """A fault inside a file; read_mesh adds the name of the file."""


def lines_of(content: bytes, continued: str | None = None) -> Iterator[tuple[int, list[str]]]:
    """Yield the words of each line that has any, with its number; what follows a # is left out.

    Args:
        content: Of the file.
        continued: What ends a line that goes on in the next, if anything does.
    """
    words: list[str] = []
    # As bytes: in a text, the second byte of the letter Å would end a line too.
    for number, line in enumerate(content.splitlines(), start=1):
        text = line.split(b"#", 1)[0].decode("latin-1").rstrip()
        goes_on = continued is not None and text.endswith(continued)
        words += (text[: -len(continued)] if goes_on and continued else text).split()
        if words and not goes_on:
            yield number, words
            words = []
    if words:
        yield number, words


def numbers(words: list[str], line: int, kind: Callable[[str], float]) -> list[float]:
    """Return words of a line as numbers."""
    try:
        return [kind(word) for word in words]
    except ValueError:
        raise DamageError(f"line {line} has {' '.join(words)[:40]!r} where numbers should be") from None


def exact(V: FloatArray) -> list[str]:
    """Return a line for each vertex; repr is the shortest text that comes back to the last bit."""
    return [" ".join(map(repr, point)) for point in V.tolist()]
