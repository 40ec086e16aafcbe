"""Results as a document: Markdown, or a page that loads nothing."""
