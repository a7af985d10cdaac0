"""`strap_rover report`: a bag or a case study on one page of HTML that needs nothing else."""
