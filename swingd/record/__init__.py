"""Reading the logs of others, and recording swingd's own events."""
