"""Seconds to start: the imports of the packages, and the command."""


class Import:
    """Each in a fresh interpreter; torch alone is the floor of `implicit` and `compare.runs.run`."""

    def timeraw_nothing(self):
        """The interpreter alone: the baseline to subtract."""
        return ""

    def timeraw_torch(self):
        return "import torch"

    def timeraw_implicit(self):
        return "import implicit"

    def timeraw_meshref(self):
        return "import meshref"

    def timeraw_compare(self):
        return "import compare"

    def timeraw_help_of_the_command(self):
        return """
        import contextlib, io, sys
        from compare.commands.cli import main
        with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):
            main(["--help"])
        """

    def timeraw_shapes_of_the_command(self):
        return """
        import contextlib, io, sys
        from compare.commands.cli import main
        with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):
            main(["shapes"])
        """
