#include <algorithm>
#include <array>
#include <cstdio>
#include <cstring>
#include <random>
#include <sstream>
#include <utility>

#include <pugixml.hpp>

#include <iotcloud/drivers/lan/onvif_finder.h>

namespace iotcloud::drivers::lan {

namespace {

constexpr std::size_t longest_scopes = 8192;

std::string new_id() {
  std::random_device random;
  std::array<char, 64> text{};
  std::snprintf(text.data(), text.size(), "urn:uuid:%08x-%04x-4%03x-8%03x-%08x%04x", random(), random() & 0xffff,
                random() & 0xfff, random() & 0xfff, random(), random() & 0xffff);
  return text.data();
}

/// The first child of that name, in whatever namespace.
pugi::xml_node child(const pugi::xml_node& parent, const char* name) {
  return parent.find_child([&](const pugi::xml_node& node) {
    const char* colon = std::strchr(node.name(), ':');
    return std::strcmp(colon == nullptr ? node.name() : colon + 1, name) == 0;
  });
}

std::string text(const pugi::xml_node& node) {
  std::string value = node.text().get();
  const auto first = value.find_first_not_of(" \t\r\n");
  if (first == std::string::npos) return "";
  return value.substr(first, value.find_last_not_of(" \t\r\n") - first + 1);
}

/// "%20" and the like, as the bytes that they stand for.
std::string unescaped(const std::string& value) {
  const auto digit = [](char c) {
    return c >= '0' && c <= '9'   ? c - '0'
           : c >= 'a' && c <= 'f' ? c - 'a' + 10
           : c >= 'A' && c <= 'F' ? c - 'A' + 10
                                  : -1;
  };
  std::string plain;
  for (std::size_t i = 0; i < value.size(); ++i) {
    if (value[i] == '%' && i + 2 < value.size() && digit(value[i + 1]) >= 0 && digit(value[i + 2]) >= 0) {
      plain += static_cast<char>(digit(value[i + 1]) * 16 + digit(value[i + 2]));
      i += 2;
    } else {
      plain += value[i];
    }
  }
  return plain;
}

}  // namespace

std::vector<std::string> OnvifFinder::questions() {
  asked_before_ = std::exchange(asked_, new_id());
  return {
      R"(<?xml version="1.0" encoding="UTF-8"?><e:Envelope xmlns:e="http://www.w3.org/2003/05/soap-envelope" )"
      R"(xmlns:w="http://schemas.xmlsoap.org/ws/2004/08/addressing" xmlns:d="http://schemas.xmlsoap.org/ws/2005/04/discovery" )"
      R"(xmlns:dn="http://www.onvif.org/ver10/network/wsdl"><e:Header><w:MessageID>)" +
      asked_ +
      R"(</w:MessageID><w:To e:mustUnderstand="true">urn:schemas-xmlsoap-org:ws:2005:04:discovery</w:To>)"
      R"(<w:Action e:mustUnderstand="true">http://schemas.xmlsoap.org/ws/2005/04/discovery/Probe</w:Action></e:Header>)"
      R"(<e:Body><d:Probe><d:Types>dn:NetworkVideoTransmitter</d:Types></d:Probe></e:Body></e:Envelope>)"};
}

std::string read_onvif_answer(std::string_view answer, const std::string& from, const std::vector<std::string>& asked,
                              const OnFound& found) {
  pugi::xml_document document;
  if (!document.load_buffer(answer.data(), answer.size())) return "it is no XML";
  const auto envelope = child(document, "Envelope");
  const std::string of = text(child(child(envelope, "Header"), "RelatesTo"));
  if (of.empty() || std::find(asked.begin(), asked.end(), of) == asked.end())
    return "it answers no question of this finder";
  const auto matches = child(child(envelope, "Body"), "ProbeMatches");
  for (auto match = child(matches, "ProbeMatch"); match; match = match.next_sibling(match.name())) {
    std::string id = text(child(child(match, "EndpointReference"), "Address"));
    if (id.empty()) return "a device has no address of its own (EndpointReference)";
    if (const auto colon = id.rfind(':'); colon != std::string::npos) id.erase(0, colon + 1);
    PropertyMap attributes{{"kind", "onvif"}, {"id", id}, {"address", from}};
    std::istringstream services(text(child(match, "XAddrs")));
    if (std::string first; services >> first) attributes["service"] = first;
    const std::string scopes = text(child(match, "Scopes")).substr(0, longest_scopes);
    std::istringstream words(scopes);
    for (std::string scope; words >> scope;) {
      constexpr std::string_view onvif = "onvif://www.onvif.org/";
      if (!scope.starts_with(onvif)) continue;
      const std::string rest = scope.substr(onvif.size());
      for (const char* name : {"name", "hardware", "location", "Profile"}) {
        if (!rest.starts_with(std::string(name) + "/")) continue;
        const std::string key = std::strcmp(name, "hardware") == 0  ? "model"
                                : std::strcmp(name, "Profile") == 0 ? "profile"
                                                                    : name;
        attributes.try_emplace(key, unescaped(rest.substr(std::strlen(name) + 1)));
      }
    }
    found("onvif " + id, attributes);
  }
  return "";
}

}  // namespace iotcloud::drivers::lan
