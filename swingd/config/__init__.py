"""Configuration files, all derived from `swingd.model.parameters`: schema, loader, checks, rendering, cache.

Imports nothing here: the daemon forwards frames before pydantic is loaded.
"""
