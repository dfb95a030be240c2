#pragma once

#include <string>

namespace iotcloud::drivers::lan {

/// What a camera answers to a probe of WS-Discovery with this id.
inline std::string probe_match(const std::string& of) {
  return R"(<?xml version="1.0"?><SOAP-ENV:Envelope xmlns:SOAP-ENV="http://www.w3.org/2003/05/soap-envelope" xmlns:wsa="a" xmlns:wsdd="d">
<SOAP-ENV:Header><wsa:RelatesTo>)" +
         of + R"(</wsa:RelatesTo></SOAP-ENV:Header><SOAP-ENV:Body><wsdd:ProbeMatches><wsdd:ProbeMatch>
<wsa:EndpointReference><wsa:Address>urn:uuid:7-8-9</wsa:Address></wsa:EndpointReference>
<wsdd:Scopes>onvif://www.onvif.org/name/Front%20Door onvif://www.onvif.org/hardware/X10 onvif://www.onvif.org/Profile/Streaming
onvif://www.onvif.org/location/hall http://other/</wsdd:Scopes>
<wsdd:XAddrs>http://10.0.0.9/onvif/device_service http://[::1]/x</wsdd:XAddrs></wsdd:ProbeMatch></wsdd:ProbeMatches></SOAP-ENV:Body>
</SOAP-ENV:Envelope>)";
}

}  // namespace iotcloud::drivers::lan
