"""The live host: event loop, links, clocks, signals and logs around the engine."""
