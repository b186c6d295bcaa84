"""Cases: what is run, as plain data; its defaults, settings and names."""
