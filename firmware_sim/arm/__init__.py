"""The pneumatic arm with three axes: its parameters, its dynamics, and what can change while it runs."""
