"""`python -m stages STAGE [NAME ...]` does what a stage of dvc.yaml does."""

import importlib
import inspect
import pkgutil
import sys

import stages
from pipeline.guard import guard


def main(*arguments: str) -> None:
    names = sorted(m.name for m in pkgutil.iter_modules(stages.__path__) if not m.name.startswith("_"))
    name, given = (arguments or ("",))[0], arguments[1:]
    if name not in names:
        _usage(f"STAGE [NAME ...], where STAGE is one of {', '.join(names)}")
    function = importlib.import_module(f"stages.{name}").main
    wanted = list(inspect.signature(function).parameters)
    if len(given) != len(wanted):
        _usage(" ".join([name, *(w.upper() for w in wanted)]))
    function(*given)


def _usage(text: str) -> None:
    print(f"usage: python -m stages {text}", file=sys.stderr)
    sys.exit(2)


if __name__ == "__main__":
    guard(main, *sys.argv[1:])
