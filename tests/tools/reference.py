"""A reference of what is public in endolab, as pages, and links between it and the notebooks.

Read off the source, so that signatures stand as they are written there and nothing is imported. A page for
each folder; the index lists what ``import endolab as el`` gives. Each entry names the notebooks that use it,
and what a notebook's page says of ``el.reconstruct`` leads to its entry.
"""

import ast
import html
import itertools
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import mistune

PACKAGE = Path(__file__).resolve().parents[2] / "endolab"
LEFT_OUT = ("cli", "course")  # what is called by other means
USUAL = {"el": "endolab"} | {name: f"endolab.{name}" for name in ("plots", "metrics", "datasets")}
SECTION = re.compile(r"^([A-Z][A-Za-z ]+)\n-{3,}\n", re.MULTILINE)
SPOKEN = re.compile(r"(?<!\">)<code>(\w+(?:\.\w+)+)([^<]*)</code>")
CODED = re.compile(r'<span class="n">\w+</span>(?:<span class="o">\.</span><span class="n">\w+</span>)*')
LISTED = ("Parameters", "Attributes")  # sections of names and what they mean
WIDE = 100  # signs of a line of a signature
STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; color: #222; }
body { max-width: 62em; margin: 0 auto; padding: 1em 1.5em 6em; }
a { color: #0b5394; text-decoration: none; } a:hover { text-decoration: underline; }
h1, h2, h3 { line-height: 1.25; } h2 { margin-top: 2.2em; border-bottom: 1px solid #ccc; }
code, pre { font: 14px/1.45 ui-monospace, "DejaVu Sans Mono", monospace; }
pre { background: #f4f4f2; padding: .6em .8em; overflow-x: auto; white-space: pre-wrap; margin: .4em 0; }
section { margin: 1.6em 0 2.4em; } section section { margin: 1em 0 1em 1.6em; }
h3 { margin: 0; font-size: 1.25em; } h4 { margin: .8em 0 .2em; font-size: 1em; }
section:target > h3 { background: #ffeeb0; }
dl { margin: .2em 0 .2em 1.2em; } dt { margin-top: .35em; } dd { margin-left: 1.6em; }
dd p, li p { margin: .2em 0; }
.used, .where { color: #666; font-size: 14px; margin: .2em 0; }
td { padding: .1em .8em .1em 0; vertical-align: top; } td p { margin: 0; }
input { font: inherit; width: 22em; padding: .3em .5em; }
@media print { pre { white-space: pre-wrap; } input { display: none; } }
"""
FILTER = """<p><input type="search" placeholder="part of a name" aria-label="part of a name"></p>
<script>
document.querySelector("input").oninput = ({ target }) => {
  for (const row of document.querySelectorAll("tr, h2, main > p"))
    row.hidden = target.value && !(row.dataset.name || "").toLowerCase().includes(target.value.toLowerCase());
};
</script>"""


@dataclass
class Entry:
    """A function, class, property or constant: where it is, how it is called, what it says of itself."""

    folder: str
    module: str
    name: str  # with its class's
    line: int
    signature: str
    text: str
    inner: list["Entry"] = field(default_factory=list)
    called: list[str] = field(default_factory=list)  # the short ways to it
    used: list[str] = field(default_factory=list)  # the notebooks that do
    is_constant: bool = False

    @property
    def address(self) -> str:
        """Of its place in the reference."""
        return f"{self.folder}.html#{self.module}.{self.name}"

    @property
    def is_shown(self) -> bool:
        """Whether it has a place there: a constant only if a stub gives it, or a notebook uses it."""
        return not self.is_constant or bool(self.called or self.used)

    @property
    def summary(self) -> str:
        """The first sentence of its text, or paragraph."""
        return self.text.split("\n\n")[0].replace("\n", " ")


def signature(node: ast.FunctionDef, name: str) -> str:
    """How a function is called, as it is written, on as many lines as it takes."""
    given = node.args
    placed = [*given.posonlyargs, *given.args]
    defaults: list[ast.expr | None] = [None] * (len(placed) - len(given.defaults))
    parts = [_argument(*both) for both in zip(placed, [*defaults, *given.defaults], strict=True)]
    if placed and placed[0].arg in ("self", "cls"):
        del parts[0]
    if given.vararg:
        parts.append(f"*{_argument(given.vararg)}")
    elif given.kwonlyargs:
        parts.append("*")
    parts += [_argument(*both) for both in zip(given.kwonlyargs, given.kw_defaults, strict=True)]
    if given.kwarg:
        parts.append(f"**{_argument(given.kwarg)}")
    returns = f" -> {ast.unparse(node.returns)}" if node.returns else ""
    line = f"{name}({', '.join(parts)}){returns}"
    inside = "".join(f"    {part},\n" for part in parts)
    return line if len(line) <= WIDE else f"{name}(\n{inside}){returns}"


def _argument(one: ast.arg, default: ast.expr | None = None) -> str:
    equals = "=" if one.annotation is None else " = "
    return ast.unparse(one) + ("" if default is None else equals + ast.unparse(default))


def entries(folder: str, module: str, source: str) -> Iterator[Entry]:
    """What is public in a module; of a constant, the lines above it are its text."""
    lines = source.splitlines()
    for node in ast.parse(source).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
            yield entry(folder, module, node)
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            name = ast.unparse(node.targets[0] if isinstance(node, ast.Assign) else node.target)
            if name.isupper() and not name.startswith("_"):
                above = itertools.takewhile(lambda line: line.startswith("#"), lines[node.lineno - 2 :: -1])
                told = " ".join(line.lstrip("# ") for line in [*above][::-1])
                yield Entry(folder, module, name, node.lineno, ast.unparse(node), told, is_constant=True)


def entry(folder: str, module: str, node: ast.FunctionDef | ast.ClassDef, above: str = "") -> Entry:
    """A function, or a class with what is public in it."""
    name, text = above + node.name, ast.get_docstring(node) or ""
    if isinstance(node, ast.FunctionDef):
        decorators = {ast.unparse(one) for one in node.decorator_list}
        if decorators & {"property", "cached_property"}:
            shown = node.name + (f": {ast.unparse(node.returns)}" if node.returns else "")
        else:
            shown = signature(node, node.name)
        return Entry(folder, module, name, node.lineno, shown, text)
    bases = ", ".join(ast.unparse(base) for base in node.bases)
    fields, inner = [], []
    for one in node.body:
        if isinstance(one, ast.FunctionDef) and one.name == "__init__":
            fields.insert(0, signature(one, node.name).removesuffix(" -> None"))
        elif isinstance(one, ast.FunctionDef) and not one.name.startswith("_"):
            inner.append(entry(folder, module, one, f"{name}."))
        elif isinstance(one, ast.AnnAssign | ast.Assign):
            line = ast.unparse(one)
            if not line.startswith("_"):
                fields.append(f"    {line}")
    head = f"class {node.name}" + (f"({bases})" if bases else "")
    return Entry(folder, module, name, node.lineno, "\n".join([head, *fields]), text, inner)


class Reference:
    """All entries, by their folders; `by_name` finds one by any dotted name that leads to it."""

    def __init__(self, package: Path = PACKAGE) -> None:
        self.folders: dict[str, dict[str, list[Entry]]] = {}
        self.texts: dict[str, str] = {}
        self.by_name: dict[str, Entry] = {}
        for path in sorted(package.rglob("*.py")):
            parts = path.relative_to(package).with_suffix("").parts
            if len(parts) < 2 or parts[0] in LEFT_OUT or any(one.startswith("_") for one in parts[:-1]):
                continue
            folder, module = parts[0], ".".join(parts[1:])
            source = path.read_text(encoding="utf-8")
            text = ast.get_docstring(ast.parse(source)) or ""
            if path.stem == "__init__":
                self.texts[".".join(parts[:-1])] = text
            elif found := list(entries(folder, module, source)):
                self.folders.setdefault(folder, {})[module] = found
                self.texts[f"{folder}.{module}"] = text
        for folder, modules in self.folders.items():
            told = self.texts[folder]
            order = sorted(modules, key=lambda module: (told + f"`{module}`").find(f"`{module}`"))
            self.folders[folder] = {module: modules[module] for module in order}
            for one in (one for found in modules.values() for one in found):
                self._name(f"endolab.{one.folder}.{one.module}.{one.name}", one)
        self.short: dict[str, Entry] = {}  # of each stub, the names that it gives
        for stub in sorted(package.rglob("__init__.pyi")):
            self._read_stub(stub, package)

    def _name(self, name: str, one: Entry) -> None:
        self.by_name[name] = one
        for deeper in one.inner:
            self.by_name[f"{name}.{deeper.name.partition('.')[2]}"] = deeper

    def _read_stub(self, stub: Path, package: Path) -> None:
        """Take the short names that a stub gives."""
        home = ".".join(["endolab", *stub.parent.relative_to(package).parts])
        for node in ast.parse(stub.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ImportFrom) and node.module:
                for name in node.names:
                    one = self.by_name.get(f"{home}.{node.module}.{name.name}")
                    if one is not None:
                        self._name(f"{home}.{name.name}", one)
                        self.short[f"{home}.{name.name}"] = one
                        one.called.append(f"{home}.{name.name}".replace("endolab.", "el.", 1))

    def find(self, dotted: str, known: Mapping[str, str]) -> Entry | None:
        """The entry that a name in a notebook, such as ``plots.show_depth``, leads to."""
        first, *rest = dotted.split(".")
        parts = [known.get(first, first), *rest]
        for length in range(len(parts), 0, -1):
            one = self.by_name.get(".".join(parts[:length]))
            if one is not None:
                return one
        return None

    def scan(self, notebook: str, cells: Sequence[str]) -> dict[str, str]:
        """Note what a notebook's code uses; return what its first names stand for."""
        known, trees = dict(USUAL), []
        for cell in cells:
            tree = ast.parse(cell)
            trees.append(tree)
            known |= imported(tree)
        names = {name for tree in trees for node in ast.walk(tree) if (name := dotted_name(node))}
        for one in {id(one): one for name in names if (one := self.find(name, known))}.values():
            one.used.append(notebook)
        return known


def imported(tree: ast.AST) -> dict[str, str]:
    """What the names that a piece of code imports from endolab stand for."""
    found = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {name.asname: name.name for name in node.names if name.asname and name.name == "endolab"}
        elif isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "endolab":
            found |= {name.asname or name.name: f"{node.module}.{name.name}" for name in node.names}
    return found


def dotted_name(node: ast.AST) -> str:
    """A name, or names with dots between them; nothing if it is something else."""
    if isinstance(node, ast.Name):
        return node.id
    if isinstance(node, ast.Attribute) and (before := dotted_name(node.value)):
        return f"{before}.{node.attr}"
    return ""


def linked(page: str, reference: Reference, known: Mapping[str, str], root: str = "api/") -> str:
    """A notebook's page whose names, in code and in text, lead to the reference."""

    def link(dotted: str, inside: str) -> str:
        one = reference.find(dotted, known)
        if one is None:
            return inside
        title = html.escape(one.summary)
        return f'<a class="endolab-api" href="{root}{one.address}" title="{title}">{inside}</a>'

    page = SPOKEN.sub(lambda match: link(match[1], match[0]), page)
    return CODED.sub(lambda match: link(re.sub(r"<[^>]*>", "", match[0]), match[0]), page)


def rendered(text: str, link: Callable[[str], str]) -> str:
    """HTML of a docstring in numpydoc's manner; `link` gives HTML for a name between backticks."""
    plain, *sections = SECTION.split(text.replace("``", "`"))
    pieces = [_prose(plain, link)]
    for title, body in zip(sections[::2], sections[1::2], strict=True):
        pieces.append(f"<h4>{title}</h4>")
        listed = title in LISTED or re.search(r"^\S.*\n    ", body, re.MULTILINE)
        pieces.append((_items if listed else _prose)(body, link))
    return "".join(pieces)


def _prose(text: str, link: Callable[[str], str]) -> str:
    marked = str(mistune.html(text.strip()))
    return re.sub(r"<code>([A-Za-z_]\w*(?:\.\w+)*)</code>", lambda match: link(match[1]), marked)


def _items(body: str, link: Callable[[str], str]) -> str:
    items = []
    for line in body.strip("\n").splitlines():
        if line and not line.startswith(" "):
            name, _, kind = line.partition(" : ")
            kind = re.sub(r"\b[A-Z]\w+", lambda match: link(match[0]), html.escape(kind))
            items.append([f"<dt><code>{html.escape(name)}</code> <i>{kind}</i></dt>", ""])
        elif items:
            items[-1][1] += line.removeprefix("    ") + "\n"
    return "<dl>" + "".join(f"{head}<dd>{_prose(told, link)}</dd>" for head, told in items) + "</dl>"


def page(title: str, body: str) -> str:
    """A page of the reference."""
    return (
        f'<!DOCTYPE html><html lang="en"><head><meta charset="utf-8"><title>{html.escape(title)}</title>'
        f"<style>{STYLE}</style></head><body>"
        '<nav><a href="../index.html">Notebooks</a> · <a href="index.html">Reference</a></nav>'
        f"<main>{body}</main></body></html>"
    )


class Writer:
    """Writes the pages of a reference; `source` leads from them to the package."""

    def __init__(self, reference: Reference, source: str) -> None:
        self.reference, self.source = reference, source

    def index(self) -> str:
        """The page of all names, those of `el` first."""
        short = sorted(self.reference.short.items(), key=lambda item: (item[1].folder, item[0]))
        mine = [(name.replace("endolab.", "el.", 1), one) for name, one in short if name.count(".") == 1]
        said = "What <code>import endolab as el</code> gives; below it all that is public, folder by folder."
        parts = [f"<h1>endolab: the reference</h1><p>{said}</p>{FILTER}<h2>el</h2>{self._table(mine)}"]
        for name, modules in self.reference.folders.items():
            parts.append(f'<h2><a href="{name}.html">endolab.{name}</a></h2>')
            every = [(f"{module}.{one.name}", one) for module, found in modules.items() for one in found]
            parts.append(self._table([item for item in every if item[1].is_shown]))
        return page("endolab: the reference", "".join(parts))

    def of_folder(self, name: str) -> str:
        """The page of a folder, module by module."""
        texts, home = self.reference.texts, f"endolab.{name}"
        parts = [f"<h1>{home}</h1>{rendered(texts[name], self._linker(home))}"]
        for module, found in self.reference.folders[name].items():
            said = rendered(texts[f"{name}.{module}"], self._linker(f"{home}.{module}"))
            entries_ = "".join(self._shown(one) for one in found if one.is_shown)
            parts.append(f'<h2 id="{module}">{module}</h2>{said}{entries_}')
        return page(home, "".join(parts))

    def _linker(self, home: str, but: Entry | None = None) -> Callable[[str], str]:
        """Return what makes HTML of a name that is said at a place: of the place, or of one around it."""
        parts = home.split(".")
        around = [".".join(parts[:length]) for length in range(len(parts), 0, -1)]

        def link(name: str) -> str:
            wide = [name, *(f"{place}.{name}" for place in around)]
            found = (self.reference.by_name.get(dotted) for dotted in wide)
            one = next((one for one in found if one is not None), None)
            if one is None or one is but or not one.is_shown:
                return f"<code>{name}</code>"
            return f'<a href="{one.address}"><code>{name}</code></a>'

        return link

    def _shown(self, one: Entry) -> str:
        """An entry, and what is in it."""
        file = f"{one.folder}/{one.module.replace('.', '/')}.py"
        place = f'<a href="{self.source}/{file}#L{one.line}">endolab/{file}</a>, line {one.line}'
        told = f'<p class="where">{"".join(f"<code>{name}</code> · " for name in one.called)}{place}</p>'
        if one.used:
            pages = [f'<a href="../{name}.html">{name.partition("_")[0]}</a>' for name in sorted(one.used)]
            told += f'<p class="used">Used in notebook{"s" * (len(pages) > 1)} {", ".join(pages)}.</p>'
        said = rendered(one.text, self._linker(f"endolab.{one.folder}.{one.module}.{one.name}", one))
        head = f"<h3>{one.name.rpartition('.')[2]}</h3>{told}<pre>{html.escape(one.signature)}</pre>"
        inner = "".join(map(self._shown, one.inner))
        return f'<section id="{one.module}.{one.name}">{head}{said}{inner}</section>'

    def _table(self, rows: Sequence[tuple[str, Entry]]) -> str:
        """Names, and the first sentences of what they say of themselves."""
        lines = []
        for name, one in rows:
            told = _prose(one.summary, self._linker(f"endolab.{one.folder}.{one.module}", one))
            link = f'<a href="{one.address}"><code>{name}</code></a>'
            lines.append(f'<tr data-name="{name}"><td>{link}</td><td>{told}</td></tr>')
        return f"<table>{''.join(lines)}</table>"


def write_reference(reference: Reference, folder: Path, source: str) -> None:
    """Write the pages into a folder; `source` leads from them to the package."""
    writer = Writer(reference, source)
    (folder / "index.html").write_text(writer.index(), encoding="utf-8")
    for name in reference.folders:
        (folder / f"{name}.html").write_text(writer.of_folder(name), encoding="utf-8")
