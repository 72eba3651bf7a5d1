"""The relay kitchen: a Franka arm, seven things to do, demonstrations that do four of them."""
