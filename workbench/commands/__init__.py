"""The commands, each a module of its name with `configure` and `run`; `workbench.cli` imports the one that is run."""
