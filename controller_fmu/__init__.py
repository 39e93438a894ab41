"""The extended L1 adaptive controller: its laws as pure functions, and the blocks made of them."""
