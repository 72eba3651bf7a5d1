"""`python -m stages STAGE [NAME ...]` does what a stage of dvc.yaml does."""

import importlib
import inspect
import pkgutil
import sys

import stages
from beso.errors import UserError
from pipeline.stage import guard


def main(*arguments: str) -> None:
    names = sorted(m.name for m in pkgutil.iter_modules(stages.__path__) if not m.name.startswith("_"))
    name, given = (arguments or ("",))[0], arguments[1:]
    if name not in names:
        raise UserError(f"usage: python -m stages STAGE [NAME ...], where STAGE is one of {', '.join(names)}")
    function = importlib.import_module(f"stages.{name}").main
    wanted = list(inspect.signature(function).parameters)
    if len(given) != len(wanted):
        raise UserError(f"usage: python -m stages {' '.join([name, *(w.upper() for w in wanted)])}")
    function(*given)


if __name__ == "__main__":
    guard(main, *sys.argv[1:])
