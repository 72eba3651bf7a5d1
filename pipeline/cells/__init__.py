"""What the stages do: one module a stage."""
