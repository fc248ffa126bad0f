"""Reading the currents of ocean models and radars from NetCDF files."""
