"""The loop closed where the effect is in all logs."""
