"""A survey: a diagnosis of each recording in a folder, one table, and the trends of machines."""
