-- P-NET on IP (IEC PAS 62412) for Wireshark: header, route, control-status, data, password.
--
-- Names behind "pnet." are those that `pnet-nat decode --format json` prints, and so are the values
-- and the errors. The password is shown only where the preference says so.
-- For Lua 5.2 to 5.4, so without operators on bits.

local pnet = Proto("pnet", "P-NET on IP")

local MIN_DATAGRAM, MAX_DATAGRAM, PASSWORD = 8, 107, 8
local HEADER, MAX_REMAINING = 4, 27
-- Datagrams that the kernel takes in one message.
local MOST_IN_ROW = 64
local BNA, SNA = 126, 127

local field = {
    datagram = ProtoField.uint8("pnet.datagram", "Datagram"),
    datagrams = ProtoField.uint8("pnet.datagrams", "Datagrams in the row"),
    length = ProtoField.uint16("pnet.length", "Length"),
    header = ProtoField.bytes("pnet.header", "Header"),
    route = ProtoField.bytes("pnet.route", "Route"),
    route_format = ProtoField.string("pnet.route_format", "Format"),
    remaining = ProtoField.uint8("pnet.remaining_route_length", "Remaining route length"),
    destination = ProtoField.uint8("pnet.destinations", "Destination"),
    source = ProtoField.uint8("pnet.sources", "Source"),
    ip_net_id = ProtoField.uint8("pnet.ip_net_id", "IPNetID"),
    node_address = ProtoField.uint8("pnet.node_address", "Node address"),
    source_ip_net_id = ProtoField.uint8("pnet.source_ip_net_id", "Source IPNetID"),
    source_node_address = ProtoField.uint8("pnet.source_node_address", "Source node address"),
    dlpdu_type = ProtoField.string("pnet.dlpdu_type", "DLPDU type"),
    control_status = ProtoField.uint8("pnet.control_status", "Control-status", base.DEC_HEX),
    data_field_format =
        ProtoField.uint8("pnet.data_field_format", "Data-field-format", base.DEC_HEX),
    data_field_flags = ProtoField.uint8("pnet.data_field_flags", "Flags", base.DEC_HEX),
    data_size = ProtoField.uint8("pnet.data_size", "Data size"),
    data = ProtoField.bytes("pnet.data", "Data"),
    password = ProtoField.string("pnet.password", "Password"),
    password_octets = ProtoField.bytes("pnet.password_octets", "Password octets"),
    error = ProtoField.string("pnet.error", "Error"),
    error_offset = ProtoField.uint16("pnet.error_offset", "Error offset"),
}
local fields = {}
for _, each in pairs(field) do
    fields[#fields + 1] = each
end
pnet.fields = fields

local malformed =
    ProtoExpert.new("pnet.malformed", "No datagram", expert.group.MALFORMED, expert.severity.ERROR)
pnet.experts = { malformed }

pnet.prefs.udp_ranges = Pref.range("UDP ranges", "",
    "Public ports of UDP Range nets, like 20001-20125, beside 34378 (Normal) and 34379 (Secure)",
    65535)
pnet.prefs.header = Pref.string("Header", "02000000", "What every datagram begins with, in hex")
pnet.prefs.show_password = Pref.bool("Show passwords", false,
    "Whoever sees a password can write to the plant. The octets below show it in any case.")

local function is_source(octet)
    return octet >= 0x80
end

-- The route at the front of `package`, an array of octets from 0: its format and number of octets.
-- Or nothing, why not, and where.
local function read_route(package, count)
    local ends = "bad route: the octets end inside the route"
    local misplaced = "bad route: a destination element stands behind a source element"
    if count < 2 then
        return nil, ends, count
    elseif is_source(package[0]) then
        return { format = "immediate", length = 2 }
    elseif is_source(package[1]) then
        return { format = "simple", length = 2 }
    elseif count < 3 then
        return nil, ends, count
    elseif is_source(package[2]) then
        if count < 4 then
            return nil, ends, count
        elseif not is_source(package[3]) then
            return nil, misplaced, 3
        end
        return { format = "extended", length = 4 }
    end
    local remaining = package[2]
    if remaining == 0 or remaining > MAX_REMAINING then
        return nil, string.format(
            "bad route: the remaining-route-length is %d, not 1 to %d", remaining, MAX_REMAINING), 2
    elseif count < 3 + remaining then
        return nil, ends, count
    end
    local sources = 0
    for at = 3, 2 + remaining do
        if is_source(package[at]) then
            sources = sources + 1
        elseif sources > 0 then
            return nil, misplaced, at
        end
    end
    if sources == 0 then
        return nil, "bad route: the route has no source element", 2 + remaining
    end
    return { format = sources == 1 and "complex" or "ip", length = 3 + remaining, remaining = true }
end

-- PAS Table 1; nothing where no row fits.
local function dlpdu_type(route, package, data_size)
    if route.format == "immediate" then
        return data_size == 0 and "acknowledge" or "immediate_reply"
    end
    local no_confirmation = package[route.length - 1] == 0x80
    if route.remaining and no_confirmation then
        return "unconfirmed"
    elseif no_confirmation or data_size <= 2 then
        return nil
    end
    for at = route.format == "ip" and 1 or 0, route.length - 1 do
        if package[at] == BNA and not (route.remaining and at == 2) then
            return "unconfirmed"
        end
    end
    return "confirmed"
end

local function role(place, value)
    if place == 1 then
        return " (IPNetID)"
    elseif place == 2 then
        return value == BNA and " (every node)" or value == SNA and " (service)" or " (node address)"
    end
    return ""
end

local function add_route(tree, tvb, route, package)
    local range = tvb(HEADER, route.length)
    local branch = tree:add(field.route, range)
    branch:append_text(", " .. route.format)
    branch:add(field.route_format, range, route.format)
    local seen = { destination = 0, source = 0 }
    local over_ip = route.format == "ip" or route.format == "extended"
    local numbers = { destination = {}, source = {} }
    for at = 0, route.length - 1 do
        local octet = tvb(HEADER + at, 1)
        if at == 2 and route.remaining then
            branch:add(field.remaining, octet)
        else
            local value = package[at] % 0x80
            local list = is_source(package[at]) and "source" or "destination"
            seen[list] = seen[list] + 1
            numbers[list][seen[list]] = value
            local item = branch:add(field[list], octet, value)
            if over_ip then
                item:append_text(role(seen[list], value))
            end
            local prefix = list == "source" and "source_" or ""
            if over_ip and seen[list] == 1 then
                branch:add(field[prefix .. "ip_net_id"], octet, value):set_generated()
            elseif over_ip and seen[list] == 2 then
                branch:add(field[prefix .. "node_address"], octet, value):set_generated()
            end
        end
    end
    return string.format("to %s from %s",
        table.concat(numbers.destination, "."), table.concat(numbers.source, "."))
end

-- Says what is wrong with a datagram, and where; gives the text for the list of packets.
local function refuse(tree, tvb, why, at)
    local count = tvb:len()
    local place = at < count and tvb(at, 1) or tvb(count, 0)
    tree:add(field.error, place, why):set_generated()
    tree:add(field.error_offset, place, at):set_generated()
    tree:add_proto_expert_info(malformed, why)
    return "Malformed: " .. why
end

-- What `octets`, a Lua string, are: their route, package and size of data. Or nothing, why not, and
-- where; with the route and the package where only the length is wrong.
local function read(octets)
    local count = #octets
    if count > MAX_DATAGRAM then
        return nil, string.format("a datagram has at most %d octets", MAX_DATAGRAM), MAX_DATAGRAM
    elseif count < MIN_DATAGRAM then
        return nil, string.format("a datagram has at least %d octets", MIN_DATAGRAM), count
    end
    local header = ByteArray.new(pnet.prefs.header)
    for at = 0, HEADER - 1 do
        if at >= header:len() or octets:byte(at + 1) ~= header:get_index(at) then
            return nil, "the header is not the expected one", at
        end
    end
    local package = {}
    for at = HEADER, count - 1 do
        package[at - HEADER] = octets:byte(at + 1)
    end
    local route, why, at = read_route(package, count - HEADER)
    if not route then
        return nil, why, HEADER + at
    end
    local found = { route = route, package = package, data = HEADER + route.length + 2 }
    found.format = package[route.length + 1] or 0
    found.size = found.format % 0x40
    local data_end = found.data + found.size
    if data_end ~= count and data_end + PASSWORD ~= count then
        return nil, "the octets behind the route do not fit the data-field-format",
            math.min(data_end, count), found
    end
    return found
end

-- Shows a datagram, or why it is none; gives the text for the list of packets.
local function show(tvb, tree)
    local count, sent = tvb:len(), tvb:reported_len()
    tree:add(field.length, tvb(0, 0), sent):set_generated()
    if count < sent then
        return refuse(tree, tvb,
            string.format("only %d of its %d octets were captured", count, sent), count)
    end
    local found, why, at, sound = read(tvb:raw())
    local way
    if found or sound then
        local begins = found or sound
        tree:add(field.header, tvb(0, HEADER))
        way = add_route(tree, tvb, begins.route, begins.package)
    end
    if not found then
        return refuse(tree, tvb, why, at)
    end
    local route, data, size = found.route, found.data, found.size
    local data_end = data + size
    local kind = dlpdu_type(route, found.package, size)
    if kind then
        tree:add(field.dlpdu_type, tvb(HEADER, route.length), kind):set_generated()
    end
    tree:add(field.control_status, tvb(data - 2, 1))
    local format = tree:add(field.data_field_format, tvb(data - 1, 1))
    format:add(field.data_field_flags, tvb(data - 1, 1), found.format - size)
    format:add(field.data_size, tvb(data - 1, 1), size)
    if size > 0 then
        tree:add(field.data, tvb(data, size))
    end
    local password = data_end < count and tvb(data_end, PASSWORD)
    if password and pnet.prefs.show_password then
        tree:add(field.password_octets, password)
    end
    tree:add(field.password, password or tvb(count, 0), password and "present" or "absent")
    return string.format("%s %s, %d data octets, password %s",
        kind and kind:gsub("_", " "):gsub("^%l", string.upper) or "Of no DLPDU type", way, size,
        password and "present" or "absent")
end

-- The length of the datagrams when `octets` are a row of them, as a capture on the router itself
-- shows a burst that the kernel cuts later: all of one length, only the last may be shorter.
local function length_in_row(octets)
    for length = MIN_DATAGRAM, math.min(MAX_DATAGRAM, #octets - 1) do
        if #octets <= length * MOST_IN_ROW then
            local at = 1
            while at <= #octets and read(octets:sub(at, at + length - 1)) do
                at = at + length
            end
            if at > #octets then
                return length
            end
        end
    end
end

function pnet.dissector(tvb, info, root)
    info.cols.protocol = "P-NET"
    local count = tvb:len()
    local octets = tvb:raw()
    local length = count == tvb:reported_len() and not read(octets) and length_in_row(octets)
    if not length then
        info.cols.info = show(tvb, root:add(pnet, tvb()))
        return
    end
    local datagrams, first = math.floor((count + length - 1) / length), nil
    for number = 1, datagrams do
        local from = (number - 1) * length
        local range = tvb(from, math.min(length, count - from))
        local tree = root:add(pnet, range)
        tree:append_text(string.format(", %d of %d", number, datagrams))
        tree:add(field.datagram, range, number):set_generated()
        tree:add(field.datagrams, range, datagrams):set_generated()
        local said = show(range:tvb(), tree)
        first = first or said
    end
    info.cols.info = string.format("%d datagrams in a row, the first: %s", datagrams, first)
end

local by_port = DissectorTable.get("udp.port")
local P_NET_PORTS = "34378-34379"
by_port:add(P_NET_PORTS, pnet)

local ranges = ""
function pnet.prefs_changed()
    if ranges ~= pnet.prefs.udp_ranges then
        if ranges ~= "" then
            by_port:remove(ranges, pnet)
            by_port:add(P_NET_PORTS, pnet) -- the ranges may have covered them
        end
        ranges = pnet.prefs.udp_ranges
        if ranges ~= "" then
            by_port:add(ranges, pnet)
        end
    end
end
