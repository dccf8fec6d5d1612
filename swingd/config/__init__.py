"""Configuration files: schema, loader, checks and rendering, all derived from `swingd.model.parameters`."""

from swingd.config.loader import load_parameters, parameters_from_json, parameters_to_json
from swingd.config.render import dump_parameters
from swingd.config.schema import json_schema

__all__ = ["dump_parameters", "json_schema", "load_parameters", "parameters_from_json", "parameters_to_json"]
