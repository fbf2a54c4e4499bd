"""The block-insertion task of the paper: composer task, batched environment, rendering."""
