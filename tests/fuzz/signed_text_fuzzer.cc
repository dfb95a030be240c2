// What comes beside a plugin as its signature, and lines of an audit log. The first byte chooses.
#include <string>

#include "iotcloud/security/audit_chain.h"
#include "iotcloud/security/plugin_signature.h"
#include "iotcloud/tests/fuzz/bytes.h"
#include "iotcloud/tests/fuzz/fuzz_target.h"

using namespace iotcloud;

IOTCLOUD_FUZZ_TARGET(signed_text, 50'000) {
  if (size == 0) return;
  const std::string text(fuzz::text(data + 1, size - 1));
  switch (*data % 3) {
    case 0: {
      const auto signature = security::parse_plugin_signature(text);
      fuzz::must(signature.head + signature.bytes == text, "nothing of a signature is lost");
      fuzz::must(signature.head.empty() == (signature.version == 0), "a version is in the line that is signed");
      return;
    }
    case 1: {
      const auto link = security::parse_audit_link(text);
      fuzz::must(!link || (link->number > 0 && link->previous.size() == 64), "a line's place is whole");
      return;
    }
    default: {
      const auto head = security::parse_audit_head(text);
      fuzz::must(!head || security::parse_audit_head(to_string(*head)) == head, "a head is read as it was written");
      return;
    }
  }
}
