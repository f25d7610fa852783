"""Hardware to numpy and plain types."""
