"""The operator's side: command line, reports, exports."""
