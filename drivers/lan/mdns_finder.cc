#include <algorithm>
#include <array>
#include <cctype>
#include <map>
#include <stdexcept>

#include <arpa/inet.h>
#include <arpa/nameser.h>
#include <netinet/in.h>
#include <resolv.h>

#include <iotcloud/drivers/lan/mdns_finder.h>

namespace iotcloud::drivers::lan {

namespace {

constexpr std::size_t most_records = 500, most_texts = 40;

/// A name in an answer, in small letters, because names differ by more than that only; empty: it cannot be read.
std::string name_at(const ns_msg& answer, const unsigned char* at) {
  std::array<char, NS_MAXDNAME> text{};
  if (ns_name_uncompress(ns_msg_base(answer), ns_msg_end(answer), at, text.data(), text.size()) < 0) return "";
  return text.data();
}

std::string small(std::string text) {
  std::transform(text.begin(), text.end(), text.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  return text;
}

/// The first label of a name as it is meant, without the escapes of ns_name_ntop().
std::string first_label(const std::string& name) {
  std::string label;
  for (std::size_t i = 0; i < name.size() && name[i] != '.'; ++i) {
    if (name[i] != '\\' || i + 1 >= name.size()) {
      label += name[i];
    } else if (i + 3 < name.size() && std::isdigit(static_cast<unsigned char>(name[i + 1])) != 0) {
      label += static_cast<char>(std::stoi(name.substr(i + 1, 3)) & 0xff);
      i += 3;
    } else {
      label += name[++i];
    }
  }
  return label;
}

struct Service {
  std::string host;
  unsigned port = 0;
};

/// The texts KEY=VALUE of a record.
void read_texts(const unsigned char* at, std::size_t size, PropertyMap& attributes) {
  for (std::size_t i = 0; i < size;) {
    const std::size_t length = at[i];
    if (i + 1 + length > size) return;
    const std::string text(reinterpret_cast<const char*>(at + i + 1), length);
    i += 1 + length;
    const auto equals = text.find('=');
    if (equals == std::string::npos || equals == 0 || attributes.size() >= most_texts) continue;
    attributes.try_emplace("txt." + small(text.substr(0, equals)), text.substr(equals + 1));
  }
}

}  // namespace

void MdnsFinder::read_properties(PropertyReader& reader) {
  for (const std::string& word : words_of(reader.text("services", ""))) {
    const bool good = word.size() > 6 && word.size() < 64 && word.front() == '_' &&
                      (word.ends_with("._tcp") || word.ends_with("._udp")) &&
                      std::count(word.begin(), word.end(), '.') == 1;
    if (!good)
      throw std::invalid_argument("property \"services\" has \"" + word + "\"; it takes names such as _http._tcp");
    services_.push_back(word);
  }
  if (services_.empty()) throw std::invalid_argument("property \"services\" names none");
}

/// Questions from another port than 5353, which responders answer to it alone (RFC 6762, section 6.7).
std::vector<std::string> MdnsFinder::questions() {
  std::vector<std::string> datagrams;
  for (const std::string& service : services_) {
    std::array<unsigned char, NS_PACKETSZ> question{};
    const std::string name = service + ".local";
    const int size = res_mkquery(ns_o_query, name.c_str(), ns_c_in, ns_t_ptr, nullptr, 0, nullptr, question.data(),
                                 static_cast<int>(question.size()));
    if (size < 0) continue;
    datagrams.emplace_back(reinterpret_cast<const char*>(question.data()), static_cast<std::size_t>(size));
  }
  return datagrams;
}

std::string read_mdns_answer(std::string_view bytes, const std::string& from, const std::vector<std::string>& wanted,
                             const OnFound& found) {
  ns_msg answer;
  if (ns_initparse(reinterpret_cast<const unsigned char*>(bytes.data()), static_cast<int>(bytes.size()), &answer) !=
          0 ||
      ns_msg_getflag(answer, ns_f_qr) == 0)
    return "it is no answer of DNS";
  std::vector<std::pair<std::string, std::string>> instances;  // service, and the instance's whole name
  std::map<std::string, Service> services;                     // by small names
  std::map<std::string, PropertyMap> texts;
  std::map<std::string, std::string> addresses;
  std::size_t records = 0;
  for (const ns_sect section : {ns_s_an, ns_s_ar}) {
    for (int i = 0; i < ns_msg_count(answer, section); ++i) {
      ns_rr record;
      if (++records > most_records) return "it has too many records";
      if (ns_parserr(&answer, section, i, &record) != 0) return "a record in it cannot be read";
      const std::string name = small(ns_rr_name(record));
      const unsigned char* data = ns_rr_rdata(record);
      const std::size_t size = ns_rr_rdlen(record);
      if (ns_rr_type(record) == ns_t_ptr) {
        const auto service = std::find_if(wanted.begin(), wanted.end(),
                                          [&](const std::string& one) { return name == small(one) + ".local"; });
        // A service that ends says so by a time to live of none.
        if (service != wanted.end() && ns_rr_ttl(record) > 0) instances.emplace_back(*service, name_at(answer, data));
      } else if (ns_rr_type(record) == ns_t_srv && size > 6) {
        services[name] = {small(name_at(answer, data + 6)), static_cast<unsigned>(data[4]) << 8 | data[5]};
      } else if (ns_rr_type(record) == ns_t_txt) {
        read_texts(data, size, texts[name]);
      } else if (ns_rr_type(record) == ns_t_a && size == 4) {
        std::array<char, INET_ADDRSTRLEN> text{};
        addresses[name] = inet_ntop(AF_INET, data, text.data(), text.size());
      }
    }
  }
  for (const auto& [service, name] : instances) {
    if (name.empty()) continue;
    PropertyMap attributes{{"kind", "mdns"}, {"service", service}, {"id", first_label(name)}, {"address", from}};
    if (const auto where = services.find(small(name)); where != services.end()) {
      attributes["host"] = where->second.host;
      attributes["port"] = std::to_string(where->second.port);
      const auto address = addresses.find(where->second.host);
      if (address != addresses.end()) attributes["address"] = address->second;
    }
    if (const auto own = texts.find(small(name)); own != texts.end())
      attributes.insert(own->second.begin(), own->second.end());
    found("mdns " + small(name), attributes);
  }
  return "";
}

}  // namespace iotcloud::drivers::lan
