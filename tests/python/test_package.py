"""Types, documentation, the notebook, the pages."""

import ast
import inspect
import os
import re
import subprocess
import sys
from pathlib import Path

import hydrograd
import pytest

ROOT = Path(__file__).parents[2]
OWN = ROOT / "src/python"


def test_everything_public_is_documented():
    missing = []
    for name in hydrograd.__all__:
        thing = getattr(hydrograd, name)
        if callable(thing) and not inspect.getdoc(thing):
            missing.append(name)
        if inspect.isclass(thing):
            for method, value in vars(thing).items():
                if not method.startswith("_") and (callable(value) or isinstance(value, property)):
                    if not inspect.getdoc(value):
                        missing.append(f"{name}.{method}")
    assert not missing
    assert all(module.__doc__ for module in (hydrograd, hydrograd.tesseract, hydrograd.mosaic))
    with pytest.raises(AttributeError, match="tensorflow"):
        _ = hydrograd.tensorflow


def test_the_package_has_its_types(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    pytest.importorskip("mypy", reason="mypy is not installed")
    folder = Path(hydrograd.__file__).parent
    assert (folder / "py.typed").exists() and (folder / "_native.pyi").exists()
    code = "import hydrograd\nq, gradient = hydrograd.Scene().value_and_gradient()\nreveal_type(q)\nreveal_type(gradient)\n"
    found = subprocess.run([sys.executable, "-m", "mypy", "-c", code], capture_output=True, text=True)
    assert 'Revealed type is "float"' in found.stdout.replace("builtins.", ""), found.stdout
    assert "ndarray" in found.stdout and found.returncode == 0, found.stdout
    # The stubs say what the compiled part has.
    found = subprocess.run([sys.executable, "-m", "mypy.stubtest", "hydrograd._native"], capture_output=True, text=True)
    assert found.returncode == 0, found.stdout


def code_of(notebook):
    """Lines of code, without empty ones and comments."""
    lines = "\n".join(cell.source for cell in notebook.cells if cell.cell_type == "code").splitlines()
    return [line for line in lines if line.strip() and not line.strip().startswith("#")]


def test_the_notebook_runs_and_improves_the_wall():
    pytest.importorskip("torch", reason="PyTorch is not installed")
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    nbformat = pytest.importorskip("nbformat", reason="nbformat is not installed")
    nbclient = pytest.importorskip("nbclient", reason="nbclient is not installed")
    notebook = nbformat.read(OWN / "notebooks/shape_the_wall.ipynb", as_version=4)
    assert len(code_of(notebook)) < 30
    nbclient.NotebookClient(notebook, timeout=300).execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    text = "".join(output.get("text", "") for output in outputs)
    before, after = re.search(r"Q (\d\.\d+) -> (\d\.\d+)", text).groups()
    assert float(after) > 1.005 * float(before), text
    assert any("image/png" in output.get("data", {}) for output in outputs)


def blocks(page):
    return re.findall(r"```python\n(.*?)```", page, re.DOTALL)


@pytest.mark.parametrize("number", range(7))
def test_the_examples_of_the_page_run(number, tmp_path, monkeypatch):
    """As they stand, in the order of the page, but at a coarser spacing."""
    examples = blocks((OWN / "README.md").read_text())
    assert len(examples) == 7
    code = examples[number]
    for module in {name.split(".")[0] for name in re.findall(r"^(?:import|from) ([\w.]+)", code, re.MULTILINE)}:
        pytest.importorskip(module, reason=f"{module} is not installed")
    ast.parse(code)
    monkeypatch.chdir(tmp_path)
    coarse = code.replace('hydrograd.Scene("heated-channel"', 'hydrograd.Scene("heated-channel", settings={"resolution.dx": 0.025}')
    assert coarse != code or "periodic_flow" in code or "navier_stokes_grid" in code
    found = subprocess.run([sys.executable, "-c", coarse], capture_output=True, text=True, env={**os.environ, "MPLBACKEND": "Agg"})
    assert found.returncode == 0, found.stderr
