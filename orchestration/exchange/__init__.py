"""A system for other tools: SSP packages and WebAssembly programs."""
