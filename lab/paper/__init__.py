"""The paper's tables and curves reproduced, and what can be concluded from them."""
