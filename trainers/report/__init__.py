"""What a run looks like afterwards: tables, curves, one page, a dashboard."""
