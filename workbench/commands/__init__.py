"""Commands, each a module with `configure` and `run`; `workbench.cli` imports only the requested one."""
