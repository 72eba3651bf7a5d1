"""Which files the scene is loaded from: our own, written from primitives, or those of CALVIN.

CALVIN's files are not part of this project. A folder with them is the folder `data` of the repository
github.com/mees/calvin_env.
"""

from dataclasses import dataclass
from pathlib import Path

from beso.envs.calvin.simulator.observations import BLOCKS
from beso.envs.calvin.simulator.panda import panda_urdf
from beso.envs.calvin.simulator.table import block_urdf, table_urdf
from beso.errors import UserError

_OFFICIAL_BLOCKS = {"block_red": "red_middle", "block_blue": "blue_small", "block_pink": "pink_big"}


@dataclass(frozen=True)
class Assets:
    """Paths of the URDF files: the arm, the table, the blocks in the order of BLOCKS."""

    panda: Path
    table: Path
    blocks: tuple[Path, ...]


def write_assets(folder: Path) -> Assets:
    """Write our own files into `folder`."""
    texts = {"panda": panda_urdf(), "table": table_urdf(), **{name: block_urdf(name) for name in BLOCKS}}
    for name, text in texts.items():
        (folder / f"{name}.urdf").write_text(text)
    panda, table, *blocks = (folder / f"{name}.urdf" for name in texts)
    return Assets(panda, table, tuple(blocks))


def official_assets(folder: Path) -> Assets:
    """CALVIN's files for scene D in its folder `data`.

    Raises:
        UserError: a file is missing.
    """
    assets = Assets(
        folder / "franka_panda" / "panda_longer_finger.urdf",
        folder / "calvin_table_D" / "urdf" / "calvin_table_D.urdf",
        tuple(folder / "blocks" / f"block_{_OFFICIAL_BLOCKS[name]}.urdf" for name in BLOCKS),
    )
    for path in (assets.panda, assets.table, *assets.blocks):
        if not path.is_file():
            raise UserError(f"{path} is missing; the folder must be `data` of github.com/mees/calvin_env")
    return assets
