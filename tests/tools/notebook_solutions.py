"""A pytest plugin: after the cells of a notebook, nbval runs the solutions of its exercises too."""

import re
from collections import defaultdict

import nbformat
import pytest
from nbval.plugin import IPyNbCell, IPyNbFile

DETAILS = re.compile(r"<details><summary>Solution</summary>(.*?)</details>", re.DOTALL)
BLOCK = re.compile(r"^```python\n(.*?)^```", re.DOTALL | re.MULTILINE)
STRICT = "import warnings\nwarnings.simplefilter('error')\n"


def solutions(cells):
    """Python in each solution of a notebook's cells; nothing where a solution is but told."""
    texts = [
        "".join(cell["source"]) for cell in cells if cell["cell_type"] == "markdown"
    ]
    return [
        "".join(BLOCK.findall(solution))
        for text in texts
        for solution in DETAILS.findall(text)
    ]


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(collector):
    """Append a notebook's solutions to its cells, for the kernel in which those have run."""
    report = yield
    if isinstance(collector, IPyNbFile) and report.passed:
        for number, code in enumerate(solutions(collector.nb.cells), 1):
            cell = nbformat.v4.new_code_cell(STRICT + code)
            more = {
                "cell_num": len(report.result),
                "cell": cell,
                "options": defaultdict(bool, check=False),
            }
            report.result.append(
                IPyNbCell.from_parent(collector, name=f"Solution {number}", **more)
            )
    return report
