"""The bridge between desk and machine: virtual sensors, and the file that holds them."""
