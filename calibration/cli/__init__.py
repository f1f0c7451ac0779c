"""The command line `softrod`. It sits above both packages; nothing imports it."""
