"""Figures in the pages: each stands between `<!-- figures: NAME -->` and `<!-- end -->` in one page."""
import os
import re
import subprocess

ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
PLACE = re.compile(r"<!-- figures: ([\w-]+) -->\n(.*?)<!-- end -->", re.DOTALL)


def pages():
    """All pages that git knows or could know."""
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "*.md"]
    listed = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=True).stdout.split("\n")
    return [os.path.join(ROOT, page) for page in sorted(set(listed)) if page]


def read(page):
    with open(page, encoding="utf-8") as file:
        return file.read()


def places():
    """(name, page) of every marked place."""
    return [(found.group(1), page) for page in pages() for found in PLACE.finditer(read(page))]


def write(name, text):
    """Puts the text into its place and says where; False if no page has one."""
    for page in pages():
        old = read(page)
        new = PLACE.sub(lambda m: f"<!-- figures: {name} -->\n{text.strip()}\n<!-- end -->" if m.group(1) == name else m.group(0), old)
        if any(found.group(1) == name for found in PLACE.finditer(old)):
            if new != old:
                with open(page + ".part", "w", encoding="utf-8") as file:
                    file.write(new)
                os.replace(page + ".part", page)
            print(f"-> {os.path.relpath(page, ROOT)}")
            return True
    return False


def check(names):
    """What is wrong with the marked places: names without one, with several, and places that no script fills."""
    found = [name for name, _ in places()]
    wrong = [f"{name}: no page has its markers" for name in names if name not in found]
    wrong += [f"{name}: {found.count(name)} places" for name in sorted(set(found)) if found.count(name) > 1]
    return wrong + [f"{name}, in {os.path.relpath(page, ROOT)}: no script prints it" for name, page in places() if name not in names]


def table(header, rows):
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(str(cell) for cell in line) + " |" for line in lines)
