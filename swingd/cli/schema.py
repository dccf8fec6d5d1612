"""``swingd schema``."""

import json

import typer

EXAMPLES = """\b
Examples:
  swingd schema > swingd.schema.json
  # first line of a configuration, for editors with a YAML language server:
  # yaml-language-server: $schema=swingd.schema.json
"""


def schema() -> None:
    """Print the JSON schema of configuration files, for editors."""
    from swingd.config.schema import json_schema

    typer.echo(json.dumps(json_schema(), indent=1))
