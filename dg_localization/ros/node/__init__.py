"""The localizer node: topics, parameters, diagnostics."""
