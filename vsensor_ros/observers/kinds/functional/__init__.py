"""The kind functional: observers of linear functionals of the state."""
