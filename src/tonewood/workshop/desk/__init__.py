"""The desk: an instrument in a browser, whose parameters are turned while it plays."""
