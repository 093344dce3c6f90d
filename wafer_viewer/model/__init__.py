"""What things are: frozen data and the roles that devices play. Touches nothing."""
