"""The error tree: what a caller may catch. Expected trouble in flight is a status value, never an exception."""


class SwingdError(Exception):
    """Base of every error that swingd raises on purpose; its text is meant for the user."""


class ConfigurationError(SwingdError):
    """A configuration cannot be used; the text names every key, its value and what was expected."""


class LinkUrlError(SwingdError):
    """A link URL is not understood; the text names the URL and the forms that are accepted."""


class LinkOpenError(SwingdError):
    """A link could not be opened (port in use, no such device, no permission)."""


class LogFormatError(SwingdError):
    """A log cannot be read as what it claims to be; the text names the file, the place and what was expected."""


class StudyError(SwingdError):
    """A flight of a study failed, or a figure lacks its flight; the text says which and how."""
