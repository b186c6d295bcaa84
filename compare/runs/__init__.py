"""Running a case: its subject, both editors, the measurement, the record, and where it runs."""
