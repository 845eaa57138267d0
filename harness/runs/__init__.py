"""Many trials: the experiment file, the plan, the workers, the rows that are kept, and what is written for people."""
