"""Regions, handles and the edits that users ask for [paper, sections 4.1 to 4.4, appendix C]."""
