"""Who failed: residuals of virtual sensors, judged by what the healthy machine has shown."""
