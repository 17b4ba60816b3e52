"""Names what a book links to and does not have: `python dead_links.py BOOK`. Fails if there is any."""

from __future__ import annotations

import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit


class Page(HTMLParser):
    """What a page links to, and what it can be linked by."""

    def __init__(self, file: Path) -> None:
        super().__init__()
        self.links: set[str] = set()
        self.anchors: set[str] = set()
        self.feed(file.read_text())

    def handle_starttag(self, _: str, attributes: list[tuple[str, str | None]]) -> None:
        """Collects links and identifiers."""
        for name, value in attributes:
            if name in {"href", "src"} and value:
                self.links.add(value)
            elif name == "id" and value:
                self.anchors.add(value)


def dead(book: Path) -> list[str]:
    """Each page with each link that leads nowhere in the book."""
    # All pages in one, with anchors of its own.
    files = [file for file in book.rglob("*.html") if file.name not in {"print.html", "404.html"}]
    pages = {file.resolve(): Page(file) for file in files}
    found = []
    for file, page in pages.items():
        for link in page.links:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            target = (file.parent / unquote(parts.path)).resolve() if parts.path else file
            anchor = unquote(parts.fragment)
            if not target.exists() or (anchor and target in pages and anchor not in pages[target].anchors):
                found.append(f"{file.relative_to(book.resolve())}: {link}")
    return sorted(found)


if __name__ == "__main__":
    nowhere = dead(Path(sys.argv[1]))
    print("\n".join(nowhere) or "every link of the book leads somewhere")
    sys.exit(bool(nowhere))
