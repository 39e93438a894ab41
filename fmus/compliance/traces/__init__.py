"""Random legal traces of calls: their table, generation, paths that must agree, shrinking and programs."""
