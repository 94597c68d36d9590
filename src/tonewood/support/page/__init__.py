"""Reports as HTML pages that need no network: head, style, player and foot, each written once."""
