-- A spiral on axes 0 and 1, drawn from its centre with the laser on, and back home in a straight line.
-- Returns where the axes are, which is where they began.

local TURNS, POINTS, RADIUS = 5, 720, 2000 -- steps
local SPEED_HZ, ACCEL = 4000, 40000

local function round(x)
  return math.floor(x + 0.5)
end

laser.set_power(20)
local x, y = 0, 0
for point = 1, POINTS do
  local share = point / POINTS
  local angle = share * TURNS * 2 * math.pi
  local to_x, to_y = round(RADIUS * share * math.cos(angle)), round(RADIUS * share * math.sin(angle))
  if to_x ~= x or to_y ~= y then
    motor.queue_line({to_x - x, to_y - y}, SPEED_HZ, ACCEL)
    x, y = to_x, to_y
  end
end
laser.set_power(0)
motor.execute()
wait_idle()
print('drawn to', motor.get_position(0), motor.get_position(1))
motor.queue_line({-x, -y}, SPEED_HZ, ACCEL)
wait_idle()
return {motor.get_position(0), motor.get_position(1)}
