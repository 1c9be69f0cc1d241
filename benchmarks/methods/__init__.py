"""The other methods. Each module has NAME, ``missing()`` and ``rows(case)``."""
