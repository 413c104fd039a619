"""What a person touches: command line, report and web app, all thin over the same library functions."""
