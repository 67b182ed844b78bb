"""A preprocessor of mdBook: what pages say on a forge, as the book needs it.

Links to files outside of docs/ become links to the page that shows them, or plain words; README.md is the book's first page;
architecture.md and changelog.md show the files at the repository's top; a file name behind a code block's language is set
above the block; a row of errors.md has its code as an anchor; a block of LaTeX with a name becomes the MathML of that name, which a browser sets by itself.
"""

import json
import posixpath
import re
import sys
from pathlib import Path

TOP = Path(__file__).resolve().parent.parent
# Pages of the book that show a file of the repository's top.
WHOLE_FILES = {"architecture.md": "ARCHITECTURE.md", "changelog.md": "CHANGELOG.md"}
# Where the book has what lies outside of docs/.
PLACES = {"ARCHITECTURE.md": "architecture.md", "CHANGELOG.md": "changelog.md", "README.md": "README.md", "models": "models.md"}
LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\]]*\])*)\]\(([^)\s]+)\)")


def linked(match, page, folder):
    """One link of `page`, whose text stands in `folder` of the repository."""
    picture, text, target = match.groups()
    if "://" in target or target.startswith(("#", "mailto:")):
        return match.group(0)
    path, _, heading = target.partition("#")
    path = posixpath.normpath(posixpath.join(folder, path))
    model = re.fullmatch(r"models/([a-z0-9-]+)\.toml", path)
    if model:
        path, heading = "models.md", model.group(1)
    elif path == "docs" or path.startswith("docs/"):
        path = path.removeprefix("docs").removeprefix("/") or "README.md"
    elif path in PLACES:
        path = PLACES[path]
    else:
        return text
    path = "index.md" if path == "README.md" else path
    path = posixpath.relpath(path, posixpath.dirname(page) or ".")
    return f"{picture}[{text}]({path}{'#' if heading else ''}{heading})"


def converted(content, page):
    """A page's text with its links and blocks as the book has them."""
    folder = posixpath.join("docs", posixpath.dirname(page)).rstrip("/")
    if page in WHOLE_FILES:
        content, folder = (TOP / WHOLE_FILES[page]).read_text(), ""
    lines, inside, formula = [], False, None
    for line in content.split("\n"):
        fence = re.match(r"( *)```(.*)", line)
        if formula:
            if fence:
                # Without blank lines Markdown takes all of it for one block of HTML.
                # Styles within elements are against the service's policy.
                maths = re.sub(r' style="text-align:(left|right)"', r' class="to-\1"', (TOP / f"book/formulas/{formula}.mathml").read_text())
                lines += ['<div class="formula">', maths.strip(), "</div>"]
                formula = None
            continue
        if fence:
            words = fence.group(2).split()
            # Commands are full of words that a highlighter takes for the shell's own.
            words = ["text", *words[1:]] if words[:1] == ["sh"] else words
            if not inside and words[:1] == ["math"] and len(words) == 2:
                formula = words[1]
                continue
            if not inside and words:
                name = words[2] if len(words) > 2 else None
                lines += [f'<p class="file-name">{name}</p>', ""] if name else []
                line = f"{fence.group(1)}```{words[0]}"
            inside = not inside
        elif not inside:
            if page == "errors.md":
                line = re.sub(r"^\| `([a-z-]+)` \|", r'| <span id="\1"></span>`\1` |', line)
            # Code between backticks stays as it is; a link's own text may hold some.
            line = LINK.sub(lambda match: linked(match, page, folder), line) if "](" in line else line
        lines.append(line)
    return "\n".join(lines)


def walk(items):
    for item in items:
        chapter = item.get("Chapter") if isinstance(item, dict) else None
        if chapter:
            source = chapter.get("source_path")
            if source:
                chapter["content"] = converted(chapter["content"], source)
            walk(chapter["sub_items"])


def main():
    if sys.argv[1:2] == ["supports"]:
        sys.exit(0 if sys.argv[2:3] == ["html"] else 1)
    _, book = json.load(sys.stdin)
    walk(book.get("items") or book.get("sections"))
    json.dump(book, sys.stdout)


if __name__ == "__main__":
    main()
