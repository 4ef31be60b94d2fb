"""Extended DEM: the model order by free energy."""

from mavdem.dem.order.choice import FlightOrders, OrderChoice, choose_order, orders_of

__all__ = ["FlightOrders", "OrderChoice", "choose_order", "orders_of"]
