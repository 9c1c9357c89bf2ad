---@meta stepfleet
-- What a script on a Stepfleet node can call, for editors that read LuaLS annotations.
-- Put this file where the editor finds it (LuaLS: `workspace.library`); nodes do not need it.
--
-- Numbers have 32 bits on every node: integers wrap at 2147483647, floats have 7 digits.
-- A function that cannot go on yet (queue full, sleep) lets the node work and returns later.

---The number of a command in its job, from 1.
---@alias CommandId integer

---The shape of a ramp: either a jerk, or the first steps.
---@class RampOptions
---@field jerk? integer Jerk, steps/s³: an S-curve.
---@field linear_steps? integer Steps of linearly growing acceleration.
---@field jump_steps? integer Steps whose speed the move starts with.
---@field unit? "hz"|"mhz"|"us"|"ticks" What the speed is told in: Hz (the default), thousandths of a Hz, or the time from step to step, µs or ticks of 62.5 ns. A queued ramp needs whole Hz.
---@field passing? integer Drives only: the speed, in the same unit, with which the target is passed; behind it the axis comes to rest, unless it is driven elsewhere by then.

---What `node.status` returns.
---@class NodeStatus
---@field state "idle"|"ready"|"running"|"paused"|"stopped"|"fault"
---@field busy boolean Whether commands are being executed.
---@field queue_depth integer Commands that have not ended, with those that wait for `motor.execute`.
---@field queue_free integer Commands that still fit.
---@field laser_percent integer
---@field lidar_mm? integer The last lidar reading.
---@field now_ms integer See `node.now_ms`.
---@field position integer[] Exact position of each axis, steps; the first one is `position[0]`.

---Commands for the axes. They wait until `motor.execute`, until the queue is full of them, or until
---the script returns; a script that fails forgets those that wait.
motor = {}

---`steps` pulses, `delay_us` apart, without a ramp.
---@param axis integer From 0.
---@param delay_us integer Time between steps, µs, from 1.
---@param steps integer With sign, not 0.
---@return CommandId
function motor.queue_move(axis, delay_us, steps) end

---Two moves, of axes 0 and 1, that start on the same tick.
---@param delay1 integer
---@param steps1 integer
---@param delay2 integer
---@param steps2 integer
---@return CommandId
function motor.queue_sync_move(delay1, steps1, delay2, steps2) end

---All axes rest.
---@param ms integer 0 to 86400000.
---@return CommandId
function motor.queue_pause(ms) end

---A move with a ramp at both ends.
---@param axis integer
---@param steps integer
---@param speed_hz integer Steps per second.
---@param accel integer Steps per second².
---@param options? RampOptions
---@return CommandId
function motor.queue_ramp(axis, steps, speed_hz, accel, options) end

---A move to a position, with a ramp at both ends.
---@param axis integer
---@param position integer
---@param speed_hz integer
---@param accel integer
---@param options? RampOptions
---@return CommandId
function motor.queue_ramp_to(axis, position, speed_hz, accel, options) end

---A move that speeds up and slows down by ESP-IDF's smoothstep, 3x² - 2x³ of the way.
---@param axis integer
---@param steps integer
---@param start_hz integer First and last speed, below speed_hz.
---@param speed_hz integer
---@param ramp_steps integer Steps from start_hz to speed_hz, from 2; a shorter move turns back half way.
---@return CommandId
function motor.queue_smooth_ramp(axis, steps, start_hz, speed_hz, ramp_steps) end

---The same to a position.
---@param axis integer
---@param position integer
---@param start_hz integer
---@param speed_hz integer
---@param ramp_steps integer
---@return CommandId
function motor.queue_smooth_ramp_to(axis, position, start_hz, speed_hz, ramp_steps) end

---All axes start and end together, straight in step space; lines that follow each other are joined
---as fast as the corner allows.
---@param steps integer[] One to four numbers, for axes 0 to 3.
---@param speed_hz integer Of the axis with most steps.
---@param accel integer
---@param jerk? integer
---@return CommandId
function motor.queue_line(steps, speed_hz, accel, jerk) end

---Names the present place of an axis, without motion.
---@param axis integer
---@param position integer
---@return CommandId
function motor.queue_set_position(axis, position) end

---Finds the reference switch of an axis.
---@param axis integer
---@return CommandId
function motor.queue_home(axis) end

---Moves C to one of its named positions.
---@param position integer 0 to 4.
---@return CommandId
function motor.queue_move_c(position) end

---Moves D to one of its two ends.
---@param on boolean
---@return CommandId
function motor.queue_move_d(on) end

---Asks for a line in the node's log: where C and D are.
---@return CommandId
function motor.queue_status_cd() end

---Waits in the queue for the other parts of a synchronized job: all go on at one instant. The other
---parts come to it by a `barrier` of the same name among their commands, or by this call; every part
---that is a script has to. A script goes on at once and queues what comes behind.
---@param name string 1 to 64 bytes, once in a script.
---@return CommandId
function motor.queue_barrier(name) end

---Begins to execute what is queued.
function motor.execute() end

---Stops at once, drops the queue, sets the latch and ends the script.
function motor.emergency_stop() end

---Whether commands are being executed.
---@return boolean
function motor.is_busy() end

---Whether a command of this script has ended: its last pulse has left the pin.
---@param id CommandId
---@return boolean
function motor.is_done(id) end

---The exact position of an axis now, steps.
---@param axis integer
---@return number
function motor.get_position(axis) end

---The speed of an axis now, steps per second, with sign.
---@param axis integer
---@return number
function motor.get_speed(axis) end

---How many commands have not ended.
---@return integer
function motor.get_queue_depth() end

---Drives an axis to a position outside the queue, or changes where and how fast it is driven, in
---flight. Waits until what was queued before has ended; what is queued behind waits until nothing is
---driven. Several axes can be driven at a time, each by itself.
---@param axis integer
---@param position integer
---@param speed_hz integer
---@param accel integer
---@param options? RampOptions
function motor.drive_to(axis, position, speed_hz, accel, options) end

---The same relative to where the axis is going; 0 changes its speed only.
---@param axis integer
---@param steps integer
---@param speed_hz integer
---@param accel integer
---@param options? RampOptions
function motor.drive_by(axis, steps, speed_hz, accel, options) end

---The same on and on, until another drive, `motor.end_drive`, or the end of the script.
---@param axis integer
---@param direction 1|-1
---@param speed_hz integer
---@param accel integer
---@param options? RampOptions
function motor.run(axis, direction, speed_hz, accel, options) end

---Brings a driven axis to rest by its ramp; without an axis all of them.
---@param axis? integer
function motor.end_drive(axis) end

---Whether an axis is driven.
---@param axis integer
---@return boolean
function motor.is_driven(axis) end

---Comes to rest on the path, to go on later.
function motor.hold() end

---Goes on after `motor.hold`.
function motor.resume() end

---Changes the speed of ramps and lines, also of those under way.
---@param percent integer Of what the commands ask for.
function motor.set_speed_percent(percent) end

laser = {}

---Sets the laser's power when the commands before have ended.
---@param power integer 0 to 100.
---@return CommandId
function laser.set_power(power) end

lidar = {}

---Reads the lidar when the commands before have ended, and waits for it. `nil` if none came in time.
---@param timeout_ms? integer From when it was asked, 1000 if not given.
---@return integer? mm
function lidar.read(timeout_ms) end

input = {}

---Whether an input is active. `stop` is always there; others if the node's configuration has them: the
---switches `0:min`, `0:max` and `0:home` of axis 0 and so on, `c:min`, `c:max`, `d:min`, `d:max`, and `probe`.
---@param name string
---@return boolean
function input.read(name) end

---The node.
---@class node
---@field name string Its name.
node = {}

---Microseconds since the node's start. Wraps: differences are right up to 35 minutes.
---@return integer
function node.now_us() end

---Milliseconds since the node's start. Wraps after 24 days.
---@return integer
function node.now_ms() end

---@return NodeStatus
function node.status() end

---Publishes a value as JSON on `fleet/node/NODE/data/SUFFIX`.
---@param suffix string Of a-z, 0-9, _ and -.
---@param value any A number, text, boolean, nil, or a table of these: a list or one with names.
function node.publish(suffix, value) end

---Calls a script that is stored on the node; it finds `args` in `...`.
---@param name string
---@param args? any
---@return any ...
function node.call(name, args) end

---Waits.
---@param ms integer
function sleep(ms) end

---Executes what is queued and waits until everything has ended.
function wait_idle() end
