"""One FMU at run time: its description and its loaded instance, here or in a process of its own."""
