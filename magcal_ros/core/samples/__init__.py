"""What sensors say: streams of samples, paired windows, and what is wrong with them."""
