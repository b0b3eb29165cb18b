"""The reproduction of the paper, figure by figure."""
