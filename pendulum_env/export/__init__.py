"""Export of models to other programs: MJCF, Python and C, and the registry of exporters of other packages."""
