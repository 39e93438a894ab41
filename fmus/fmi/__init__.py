"""One FMU at run time: its description and its loaded instance, in this process or in a separate one."""
