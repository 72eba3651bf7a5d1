"""The paper's names for what params.yaml names in lower case."""

ENVIRONMENTS = {"block_push": "Block-Push"}
METHODS = {
    "gcbc": "GCBC",
    "c_ibc": "C-IBC",
    "lmp": "LMP",
    "ril": "RIL",
    "c_bet": "C-BeT",
    "cx_diff": "CX-Diff",
    "c_beso": "C-BESO",
    "cfg_beso": "CFG-BESO",
}
METRICS = {"reward": "Reward", "result": "Result"}
GOALS = {"training": "training goals", "held_out": "held-out goals"}
