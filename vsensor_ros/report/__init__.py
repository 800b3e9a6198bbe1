"""What a design says to people: on the terminal and on a page."""
