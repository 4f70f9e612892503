"""The paper's numbers and figures beside ours: pure, from records and models to rows and plots."""
