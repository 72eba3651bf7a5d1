"""What each stage of dvc.yaml does: `python -m stages STAGE [ENV [METHOD]]`."""
