"""How names and values of params.yaml read in a table."""

from typing import Any

# Samplers and schedules as the paper's tables have them.
VALUES = {
    "ddim": "DDIM",
    "dpm_2": "DPM",
    "dpm_2_ancestral": "DPM, ancestral",
    "dpmpp_2m": "DPM++(2M)",
    "dpmpp_2s": "DPM++(2S)",
    "dpmpp_2s_ancestral": "DPM++(2S), ancestral",
    "euler_ancestral": "Euler, ancestral",
    "iddpm": "IDDPM",
    "ve": "VE",
    "ve_published": "VE, as published",
    "vp": "VP",
    "vp_published": "VP, as published",
}


def words(name: str) -> str:
    """A parameter's name as it stands in a table's head: `guidance_scale` is Guidance scale."""
    return name[:1].upper() + name[1:].replace("_", " ")


def value(of: Any) -> str:
    """A parameter's value as it stands in a table."""
    if of is None:
        return "all"
    if isinstance(of, str):
        return VALUES.get(of, words(of))
    return f"{of:g}" if isinstance(of, float) else str(of)
