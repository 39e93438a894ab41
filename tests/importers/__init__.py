"""Other people's importers, each running SSP packages of this project in a process of its own."""
