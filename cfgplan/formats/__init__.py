"""File formats: environment files in YAML, JSON and the paper's XML, and plan files, and importers."""
