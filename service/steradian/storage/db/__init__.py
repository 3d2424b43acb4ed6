"""Database: engine, tables, column types, locks, change detection."""
