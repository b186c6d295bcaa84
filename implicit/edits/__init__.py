"""What a user asks for: regions and handles, and the edits themselves [paper, sections 4.1 to 4.4, appendix C]."""
