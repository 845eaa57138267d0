"""Many trials: the experiment file, the plan, the workers, the stored rows, tables and reports."""
