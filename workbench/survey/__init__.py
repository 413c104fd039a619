"""Diagnosis of each recording in a folder, with one table and the trends of parameters."""
