"""Test sheets in the form that ISO 230-2 and ISO 230-6 ask for."""
