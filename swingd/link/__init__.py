"""MAVLink: codec and adapter without I/O, and the thin transports under them."""
