#include <algorithm>
#include <array>
#include <utility>

#include <nlohmann/json.hpp>

#include <iotcloud/drivers/mqtt/finder/announcements.h>

namespace iotcloud::drivers::mqtt {

using nlohmann::json;

namespace {

constexpr int deepest = 16;  ///< lists and objects within each other: the library copies and destroys them recursively

/// Whether the text has no more than `deepest` levels of lists and objects.
bool is_flat_enough(std::string_view text) {
  int depth = 0;
  bool quoted = false;
  for (std::size_t i = 0; i < text.size(); ++i) {
    const char c = text[i];
    if (quoted && c == '\\') {
      ++i;
    } else if (c == '"') {
      quoted = !quoted;
    } else if (!quoted && (c == '{' || c == '[')) {
      if (++depth > deepest) return false;
    } else if (!quoted && (c == '}' || c == ']')) {
      --depth;
    }
  }
  return true;
}

/// The object that the payload is; nullopt: it is none.
std::optional<json> object_of(std::string_view payload) {
  if (!is_flat_enough(payload)) return std::nullopt;
  auto read = json::parse(payload, nullptr, false);
  if (!read.is_object()) return std::nullopt;
  return read;
}

/// A text, number or flag as text; empty: it is something else.
std::string text_of(const json& value) {
  if (value.is_string()) return value.get<std::string>();
  if (value.is_number() || value.is_boolean()) return value.dump();
  return "";
}

using Pair = std::pair<std::string_view, std::string_view>;

/// Abbreviations of keys that are not regular.
constexpr Pair short_keys[] = {
    {"stat_t", "state_topic"},
    {"cmd_t", "command_topic"},
    {"t", "topic"},
    {"avty", "availability"},
    {"avty_t", "availability_topic"},
    {"pl_avail", "payload_available"},
    {"pl_not_avail", "payload_not_available"},
    {"dev", "device"},
    {"ids", "identifiers"},
    {"cns", "connections"},
    {"mf", "manufacturer"},
    {"mdl", "model"},
    {"mdl_id", "model_id"},
    {"sw", "sw_version"},
    {"hw", "hw_version"},
    {"sa", "suggested_area"},
    {"sn", "serial_number"},
    {"cu", "configuration_url"},
    {"uniq_id", "unique_id"},
    {"obj_id", "object_id"},
    {"cmps", "components"},
    {"p", "platform"},
    {"set_pos_t", "set_position_topic"},
    {"pos_t", "position_topic"},
    {"set_fan_spd_t", "set_fan_speed_topic"},
    {"fanspd_t", "fan_speed_topic"},
    {"json_attr_t", "json_attributes_topic"},
    {"curr_temp_t", "current_temperature_topic"},
    {"curr_hum_t", "current_humidity_topic"},
    {"act_t", "action_topic"},
    {"err_t", "error_topic"},
    {"img_t", "image_topic"},
    {"l_ver_t", "latest_version_topic"},
    {"tilt_status_t", "tilt_status_topic"},
};

/// Abbreviations of what stands before _stat_t and _cmd_t.
constexpr Pair short_words[] = {
    {"bri", "brightness"},
    {"clr_temp", "color_temp"},
    {"clrm", "color_mode"},
    {"fx", "effect"},
    {"hum", "target_humidity"},
    {"osc", "oscillation"},
    {"pct", "percentage"},
    {"pow", "power"},
    {"pr_mode", "preset_mode"},
    {"temp", "temperature"},
    {"temp_hi", "temperature_high"},
    {"temp_lo", "temperature_low"},
    {"dir", "direction"},
    {"send", "send"},
    {"whit", "white"},
};

std::string_view whole_word(std::string_view word, const Pair* begin, const Pair* end) {
  const auto* found = std::find_if(begin, end, [&](const Pair& pair) { return pair.first == word; });
  return found == end ? word : found->second;
}

/// A key without abbreviations: brightness_command_topic of bri_cmd_t.
std::string whole_key(std::string_view key) {
  const auto whole = whole_word(key, std::begin(short_keys), std::end(short_keys));
  if (whole != key) return std::string(whole);
  for (const auto& [end, meaning] :
       {Pair{"_stat_t", "_state_topic"}, Pair{"_cmd_t", "_command_topic"}, Pair{"_t", "_topic"}}) {
    if (!key.ends_with(end)) continue;
    const auto word = key.substr(0, key.size() - end.size());
    return std::string(whole_word(word, std::begin(short_words), std::end(short_words))) + std::string(meaning);
  }
  return std::string(key);
}

/// The object with whole keys.
json with_whole_keys(const json& object) {
  json whole = json::object();
  for (const auto& [key, value] : object.items()) whole[whole_key(key)] = value;
  return whole;
}

/// The same; empty also for a text that is too long to say what a device is.
std::string short_text_of(const json& value) {
  constexpr std::size_t longest = 1024;
  std::string text = text_of(value);
  return text.size() > longest ? "" : text;
}

std::string value_of(const json& object, const char* key) {
  const auto found = object.find(key);
  return found == object.end() ? "" : short_text_of(*found);
}

/// A topic with the base topic in the place of a `~` at one of its ends.
std::string with_base(std::string topic, const std::string& base) {
  if (topic.starts_with('~')) return base + topic.substr(1);
  if (topic.ends_with('~')) return topic.substr(0, topic.size() - 1) + base;
  return topic;
}

/// Whether a list of topics of the driver mqtt can hold it.
bool is_listable(const std::string& topic) {
  constexpr std::size_t longest = 1024;
  constexpr std::ptrdiff_t most_levels = 200;  // libmosquitto takes no topic of more
  const auto slashes = std::count(topic.begin(), topic.end(), '/');
  return !topic.empty() && topic.size() <= longest && slashes < most_levels && topic.front() != '$' &&
         topic.front() != ' ' && topic.back() != ' ' && std::none_of(topic.begin(), topic.end(), [](char c) {
           return static_cast<unsigned char>(c) < 0x20 ||
                  std::string_view("#+,=\x7f").find(c) != std::string_view::npos;
         });
}

/// A channel's name of any text.
std::string channel_name(std::string_view text) {
  constexpr std::size_t longest = 60;
  std::string name(text.substr(0, longest));
  std::replace_if(
      name.begin(), name.end(),
      [](char c) {
        return !((c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '_' || c == '-');
      },
      '_');
  if (name.empty() || name.front() == '-') name.insert(0, "x");
  return name == "publish" ? "publish_" : name;
}

/// What a key of a topic adds to its entity's name: "" of state_topic, ".brightness" of brightness_command_topic.
std::string name_of_key(std::string_view key) {
  for (const std::string_view end : {"_state_topic", "_command_topic", "_topic"}) {
    if (!key.ends_with(end)) continue;
    const auto word = key.substr(0, key.size() - end.size());
    return word.empty() || word == "state" || word == "command" ? "" : "." + channel_name(word);
  }
  return "";
}

bool is_command_key(std::string_view key) {
  return key.ends_with("command_topic") || key.starts_with("set_");
}

std::string device_id(const json& device) {
  const auto ids = device.find("identifiers");
  if (ids != device.end()) {
    const std::string id = short_text_of(ids->is_array() && !ids->empty() ? ids->front() : *ids);
    if (!id.empty()) return id;
  }
  const auto connections = device.find("connections");
  if (connections == device.end() || !connections->is_array() || connections->empty()) return "";
  const auto& first = connections->front();
  return first.is_array() && first.size() == 2 ? short_text_of(first[1]) : "";
}

}  // namespace

void PlainAnnouncements::take(const std::string& topic, std::string_view payload) {
  const std::string key = "announcement " + topic;
  if (payload.empty()) return findings_.gone(key);
  const auto object = object_of(payload);
  if (!object) return findings_.warn("the announcement on " + topic + " is no JSON object");
  PropertyMap attributes;
  for (const auto& [name, value] : object->items()) {
    const std::string text = text_of(value);
    if (!text.empty() || value.is_string()) attributes[name] = text;
  }
  attributes["kind"] = "announcement";
  attributes["topic"] = topic;
  findings_.found(key, attributes);
}

bool HomeAssistant::is_announcement(std::string_view topic) const {
  if (!topic.starts_with(prefix_ + "/") || !topic.ends_with("/config")) return false;
  const auto levels = std::count(topic.begin() + static_cast<std::ptrdiff_t>(prefix_.size()), topic.end(), '/');
  return levels == 3 || levels == 4;
}

std::optional<std::vector<HomeAssistant::Entity>> HomeAssistant::read(const std::string& topic,
                                                                      std::string_view payload) const {
  const auto object = object_of(payload);
  if (!object) return std::nullopt;
  const json whole = with_whole_keys(*object);
  const auto rest = std::string_view(topic).substr(prefix_.size() + 1);
  const std::string component(rest.substr(0, rest.find('/')));
  const std::string without_config = topic.substr(0, topic.rfind('/'));
  const std::string object_id = without_config.substr(without_config.rfind('/') + 1);
  json device = json::object();
  if (const auto found = whole.find("device"); found != whole.end() && found->is_object())
    device = with_whole_keys(*found);
  std::string id = device_id(device);
  if (id.empty() && component == "device") id = object_id;
  if (id.empty()) id = value_of(whole, "unique_id");
  if (id.empty()) id = without_config.substr(prefix_.size() + 1);

  const auto entity_of = [&](const json& entity, const std::string& kind, const std::string& fallback) {
    Entity made;
    made.device = "homeassistant " + id;
    made.component = kind;
    made.attributes = {{"kind", "homeassistant"}, {"id", id}};
    for (const char* name : {"name", "manufacturer", "model", "model_id", "serial_number", "sw_version", "hw_version",
                             "suggested_area", "via_device", "configuration_url"}) {
      if (std::string value = value_of(device, name); !value.empty()) made.attributes[name] = std::move(value);
    }
    if (device.empty()) {
      if (std::string name = value_of(entity, "name"); !name.empty()) made.attributes["name"] = std::move(name);
    }
    std::string own = value_of(entity, "object_id");
    if (own.empty()) own = fallback;
    std::string base = value_of(entity, "~");
    if (base.empty()) base = value_of(whole, "~");
    for (const auto& [key, value] : entity.items()) {
      if (!(key.ends_with("_topic") || key == "topic") || key == "availability_topic" || !value.is_string()) continue;
      made.topics.push_back(
          {with_base(value.get<std::string>(), base), channel_name(own) + name_of_key(key), is_command_key(key)});
    }
    const auto availability_in = [&](const json& from) {
      made.availability = value_of(from, "availability_topic");
      json first = from;
      if (const auto list = from.find("availability"); list != from.end() && made.availability.empty()) {
        first = list->is_array() && !list->empty() ? list->front() : *list;
        if (!first.is_object()) return;
        first = with_whole_keys(first);
        made.availability = value_of(first, "topic");
      }
      made.available = value_of(first, "payload_available");
      made.not_available = value_of(first, "payload_not_available");
    };
    availability_in(entity);
    if (made.availability.empty()) availability_in(whole);
    made.availability = with_base(made.availability, base);
    return made;
  };

  std::vector<Entity> entities;
  if (component != "device") {
    entities.push_back(entity_of(whole, component, object_id));
    return entities;
  }
  const auto components = whole.find("components");
  if (components == whole.end() || !components->is_object()) return std::nullopt;
  for (const auto& [name, value] : components->items()) {
    if (!value.is_object()) continue;
    const json entity = with_whole_keys(value);
    entities.push_back(entity_of(entity, value_of(entity, "platform"), name));
  }
  return entities;
}

std::size_t HomeAssistant::Entity::bytes() const {
  constexpr std::size_t overhead = 64;  // of a text in a list or a map, about
  std::size_t bytes =
      sizeof(Entity) + device.size() + component.size() + availability.size() + available.size() + not_available.size();
  for (const auto& [name, value] : attributes) bytes += overhead + name.size() + value.size();
  for (const Topic& topic : topics) bytes += overhead + topic.topic.size() + topic.name.size();
  return bytes;
}

void HomeAssistant::forget(const std::string& topic, std::set<std::string>& changed) {
  const auto known = announced_.find(topic);
  if (known == announced_.end()) return;
  entities_ -= known->second.size();
  for (const Entity& entity : known->second) {
    bytes_ -= entity.bytes();
    devices_[entity.device].announced.erase(topic);
    changed.insert(entity.device);
  }
  announced_.erase(known);
}

void HomeAssistant::take(const std::string& topic, std::string_view payload) {
  if (!is_announcement(topic)) return;
  std::set<std::string> changed;
  auto entities = payload.empty() ? std::vector<Entity>() : read(topic, payload);
  if (!entities) return findings_.warn("the announcement on " + topic + " is no object of Home Assistant's discovery");
  forget(topic, changed);
  std::size_t bytes = 0;
  for (const Entity& entity : *entities) bytes += entity.bytes();
  if (entities_ + entities->size() > most_entities || entities->size() > most_entities_of_device ||
      bytes_ + bytes > most_bytes_) {
    bytes = 0;
    findings_.warn("the announcement on " + topic + " is one too many");
    entities->clear();
  }
  for (const Entity& entity : *entities) {
    devices_[entity.device].announced.insert(topic);
    changed.insert(entity.device);
  }
  entities_ += entities->size();
  bytes_ += bytes;
  if (!entities->empty()) announced_.emplace(topic, *std::move(entities));
  for (const auto& device : changed) report(device);
}

/// Tells what all announcements of a device say together.
void HomeAssistant::report(const std::string& key) {
  const Device& device = devices_.at(key);
  PropertyMap attributes;
  std::set<std::string> components;
  std::map<std::string, std::pair<std::string, int>> read_topics;  // name, and how many entities read it
  std::vector<std::string> order;
  std::map<std::string, std::string> command_topics;  // by name
  std::size_t entities = 0;
  for (const auto& topic : device.announced) {
    if (entities > most_entities_of_device) break;
    for (const Entity& entity : announced_.at(topic)) {
      if (entity.device != key || ++entities > most_entities_of_device) continue;
      attributes.insert(entity.attributes.begin(), entity.attributes.end());
      if (!entity.component.empty()) components.insert(entity.component);
      if (!entity.availability.empty() && !attributes.contains("availability") && is_listable(entity.availability)) {
        attributes["availability"] = entity.availability;
        if (!entity.available.empty()) attributes["available"] = entity.available;
        if (!entity.not_available.empty()) attributes["not_available"] = entity.not_available;
      }
      for (const Topic& of : entity.topics) {
        if (!is_listable(of.topic)) {
          findings_.warn("a topic of " + key + " is passed over: " + topic + " has one with wildcards, \",\" or \"=\"");
        } else if (of.command) {
          command_topics.emplace(of.name, of.topic);
        } else if (const auto [at, fresh] = read_topics.try_emplace(of.topic, of.name, 1); fresh) {
          order.push_back(of.topic);
        } else {
          ++at->second.second;
        }
      }
    }
  }
  if (attributes.empty()) {
    devices_.erase(key);
    return findings_.gone(key);
  }
  std::string list;
  std::set<std::string> names;
  for (const auto& topic : order) {
    // A topic that several entities read has no name of one of them.
    const auto& [own, readers] = read_topics.at(topic);
    const std::string wanted = readers > 1 ? "state" : own;
    std::string name = wanted;
    for (int i = 2; !names.insert(name).second; ++i) name = wanted + "-" + std::to_string(i);
    list += (list.empty() ? "" : ", ") + topic + "=" + name;
  }
  if (!list.empty()) attributes["subscribe"] = list;
  list.clear();
  for (const auto& [name, topic] : command_topics) list += (list.empty() ? "" : ", ") + topic + "=" + name;
  if (!list.empty()) attributes["publish_to"] = list;
  list.clear();
  for (const auto& component : components) list += (list.empty() ? "" : " ") + component;
  attributes["components"] = list;
  findings_.found(key, attributes);
}

void HomeAssistant::clear() {
  announced_.clear();
  devices_.clear();
  entities_ = bytes_ = 0;
}

}  // namespace iotcloud::drivers::mqtt
