"""Thing Descriptions of the Web of Things (W3C, TD 1.1): the properties and events that things offer."""
