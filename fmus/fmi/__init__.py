"""One FMU at run time: its description and its loaded instance."""
