"""The outer loop of every edit, what it holds, and what it gives back."""
