"""Options that several commands share."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from swingd.model.parameters import Parameters

Config = Annotated[
    Path | None,
    typer.Option("-c", "--config", metavar="FILE", help="Configuration in YAML; without it every key has its default."),
]
Overrides = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Set one key, for example payload.mass_kg=0.4; repeatable."),
]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of text.")]


def given(config: Path | None, overrides: list[str] | None) -> "Parameters | None":
    """Load what the options say; None where neither was given, for a recording has parameters of its own.

    Raises
    ------
    ConfigurationError
        As the loader does.
    """
    from swingd.config.loader import load_parameters

    return load_parameters(config, overrides or ()) if config is not None or overrides else None
