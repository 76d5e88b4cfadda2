import inspect
import subprocess
import sys
from importlib.resources import files

import antirad


def public():
    for name in antirad.__all__:
        thing = getattr(antirad, name)
        yield name, thing
        if inspect.isclass(thing) and thing.__module__ == "antirad" and not issubclass(thing, Exception):
            for member in vars(thing):
                if not member.startswith("_"):
                    yield f"{name}.{member}", getattr(thing, member)


def test_everything_public_is_documented():
    names = [name for name, thing in public() if name != "__version__" and not inspect.getdoc(thing)]
    assert names == []
    assert len(list(public())) > 100


def test_keyword_arguments_are_described():
    for name, thing in public():
        if not (inspect.isbuiltin(thing) or inspect.ismethoddescriptor(thing)):
            continue
        described = inspect.getdoc(thing)
        parameters = [p for p in inspect.signature(thing).parameters if p != "self"]
        if "Args:" in described:
            missing = [p for p in parameters if f"{p}:" not in described and f"{p}," not in described]
            assert missing == [], name


def test_types_are_part_of_the_package():
    package = files("antirad")
    assert package.joinpath("py.typed").is_file() and package.joinpath("_antirad.pyi").is_file()


def test_neither_torch_nor_jax_nor_tqdm_is_loaded_unasked():
    code = "import antirad, sys; print(sorted({'torch', 'jax', 'tqdm'} & set(sys.modules)))"
    assert subprocess.check_output([sys.executable, "-c", code], text=True).strip() == "[]"


def test_a_bar_of_tqdm(capsys):
    from rooms import room

    antirad.Engine(room()).solve(progress=True)
    shown = capsys.readouterr().err
    assert "solve: 100%" in shown and "passes, residual" in shown
