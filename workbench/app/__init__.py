"""Web app with the functions of the command line: load, compare, diagnose, add, export."""
