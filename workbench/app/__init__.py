"""The workbench in a browser: load, compare, diagnose, add, export, over the same functions as the command line."""
