"""What a demo begins with: how real motors compare, in a minute, from any logs of them."""
