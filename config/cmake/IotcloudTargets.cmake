# One function for each kind of target. `USES` names rooms (tests/house checks the includes against it),
# `LIBRARIES` and `PRIVATE_LIBRARIES` name third-party targets.
include(IotcloudPrecompiled)

function(_iotcloud_setup target)
  cmake_parse_arguments(arg "" "" "USES;LIBRARIES;PRIVATE_LIBRARIES" ${ARGN})
  list(TRANSFORM arg_USES PREPEND iotcloud_)
  target_link_libraries(${target} PUBLIC ${arg_USES} ${arg_LIBRARIES} PRIVATE ${arg_PRIVATE_LIBRARIES})
  target_link_libraries(${target} PRIVATE $<BUILD_INTERFACE:iotcloud_warnings>)
  target_include_directories(${target} PUBLIC $<BUILD_INTERFACE:${PROJECT_BINARY_DIR}/include>)
  target_include_directories(${target} SYSTEM PRIVATE ${IOTCLOUD_GENERATED_DIR})
endfunction()

# A room, or a part of one: a static library `iotcloud_<name>`, exported as `iotcloud::<name>`.
#   iotcloud_room(NAME brokers SOURCES a.cc HEADERS a.h USES config LIBRARIES ... PRIVATE_LIBRARIES ... [INSTALL])
# HEADERS are the public ones. INSTALL: authors of drivers, spouts and bolts link it.
function(iotcloud_room)
  cmake_parse_arguments(arg "INSTALL" "NAME" "SOURCES;HEADERS;USES;LIBRARIES;PRIVATE_LIBRARIES" ${ARGN})
  set(target iotcloud_${arg_NAME})
  if(arg_SOURCES)
    add_library(${target} STATIC ${arg_SOURCES})
    _iotcloud_setup(${target} USES ${arg_USES} LIBRARIES ${arg_LIBRARIES} PRIVATE_LIBRARIES ${arg_PRIVATE_LIBRARIES})
    iotcloud_precompiled(${target} rooms)
    set(scope PUBLIC)
  else()
    add_library(${target} INTERFACE)
    list(TRANSFORM arg_USES PREPEND iotcloud_)
    target_link_libraries(${target} INTERFACE ${arg_USES} ${arg_LIBRARIES})
    target_include_directories(${target} INTERFACE $<BUILD_INTERFACE:${PROJECT_BINARY_DIR}/include>)
    set(scope INTERFACE)
  endif()
  add_library(iotcloud::${arg_NAME} ALIAS ${target})
  set_target_properties(${target} PROPERTIES EXPORT_NAME ${arg_NAME})
  if(arg_HEADERS)
    # Base folder and files both by way of the linked path: `#include <iotcloud/...>` in the tree and installed.
    file(RELATIVE_PATH here ${PROJECT_SOURCE_DIR} ${CMAKE_CURRENT_SOURCE_DIR})
    list(TRANSFORM arg_HEADERS PREPEND ${PROJECT_BINARY_DIR}/include/iotcloud/${here}/)
    target_sources(${target} ${scope} FILE_SET HEADERS BASE_DIRS ${PROJECT_BINARY_DIR}/include FILES ${arg_HEADERS})
  endif()
  if(arg_INSTALL)
    # Their headers need it, and a project of somebody else's has its compiler's default.
    target_compile_features(${target} ${scope} $<INSTALL_INTERFACE:cxx_std_20>)
    set_property(GLOBAL APPEND PROPERTY IOTCLOUD_SDK_TARGETS ${target})
  endif()
endfunction()

# A program, installed to bin/. What is installed is a component of its own name, so that an image takes single ones.
function(iotcloud_program)
  cmake_parse_arguments(arg "" "NAME" "SOURCES;USES;LIBRARIES" ${ARGN})
  add_executable(${arg_NAME} ${arg_SOURCES})
  _iotcloud_setup(${arg_NAME} USES ${arg_USES} LIBRARIES ${arg_LIBRARIES})
  set_target_properties(${arg_NAME} PROPERTIES ENABLE_EXPORTS OFF)
  install(TARGETS ${arg_NAME} RUNTIME DESTINATION bin COMPONENT ${arg_NAME})
endfunction()

# A plugin (a driver, or components of a topology): a module without "lib" in its name, in build/<preset>/plugins.
function(iotcloud_plugin)
  cmake_parse_arguments(arg "" "NAME" "SOURCES;USES;LIBRARIES" ${ARGN})
  add_library(${arg_NAME} MODULE ${arg_SOURCES})
  set_target_properties(${arg_NAME} PROPERTIES PREFIX "")
  _iotcloud_setup(${arg_NAME} USES ${arg_USES} LIBRARIES ${arg_LIBRARIES})
  install(TARGETS ${arg_NAME} LIBRARY DESTINATION lib/iotcloud/plugins COMPONENT ${arg_NAME})
endfunction()

# A GoogleTest program; each of its tests is a test of ctest.
#   LABELS: `unit` (fast, no server), `contract` (short, real servers too), `server`, `system` (several processes),
#   `long`. Sanitizer runs take `unit` and `contract`.
#   WHOLE words: its tests share servers that cost seconds to start, so ctest runs the program once for each word, with
#   the tests whose names contain it. Those that may take longest are begun first, or the last one runs alone.
# A test whose server cannot be had here (tests/servers/private_server.h) ends with IOTCLOUD_TEST_SKIPPED.
function(iotcloud_test)
  set(skipped 77)
  cmake_parse_arguments(arg "" "NAME;TIMEOUT" "SOURCES;USES;LIBRARIES;LABELS;WHOLE" ${ARGN})
  if(NOT arg_TIMEOUT)
    set(arg_TIMEOUT 300)
  endif()
  add_executable(${arg_NAME} ${arg_SOURCES})
  _iotcloud_setup(${arg_NAME} USES ${arg_USES} LIBRARIES ${arg_LIBRARIES} iotcloud_test_options GTest::gmock_main)
  iotcloud_precompiled(${arg_NAME} tests)
  # Test sources may share helpers of their own folder tree: <iotcloud/tests/...>. Scripts that they run stand here:
  target_compile_definitions(${arg_NAME} PRIVATE IOTCLOUD_TEST_SERVERS="${PROJECT_SOURCE_DIR}/tests/servers"
                                                 IOTCLOUD_TEST_SKIPPED=${skipped})
  if(IOTCLOUD_SANITIZE MATCHES thread)
    target_sources(${arg_NAME} PRIVATE ${PROJECT_SOURCE_DIR}/tests/c11_threads_for_tsan.cc)
  endif()
  if(arg_WHOLE)
    foreach(word ${arg_WHOLE})
      add_test(NAME ${arg_NAME}.${word} COMMAND ${arg_NAME} --gtest_filter=*${word}*)
      set_tests_properties(${arg_NAME}.${word} PROPERTIES TIMEOUT ${arg_TIMEOUT} LABELS "${arg_LABELS}"
                                                          SKIP_RETURN_CODE ${skipped} COST ${arg_TIMEOUT})
    endforeach()
  else()
    gtest_discover_tests(${arg_NAME} PROPERTIES TIMEOUT ${arg_TIMEOUT} LABELS "${arg_LABELS}" SKIP_RETURN_CODE ${skipped}
                                     DISCOVERY_TIMEOUT 60)
  endif()
endfunction()

# A libFuzzer target, with the preset `fuzz` only; the target `fuzzers` builds them all.
function(iotcloud_fuzzer)
  cmake_parse_arguments(arg "" "NAME" "SOURCES;USES;LIBRARIES" ${ARGN})
  add_executable(${arg_NAME} ${arg_SOURCES})
  _iotcloud_setup(${arg_NAME} USES ${arg_USES} LIBRARIES ${arg_LIBRARIES})
  target_link_options(${arg_NAME} PRIVATE -fsanitize=fuzzer)
  add_dependencies(fuzzers ${arg_NAME})
endfunction()

# A program that measures; the target `benchmarks` builds them all. Installed only by its component's name. SMOKE: arguments of a short run, which becomes a test.
function(iotcloud_benchmark)
  cmake_parse_arguments(arg "" "NAME" "SOURCES;USES;LIBRARIES;SMOKE" ${ARGN})
  add_executable(${arg_NAME} ${arg_SOURCES})
  _iotcloud_setup(${arg_NAME} USES ${arg_USES} LIBRARIES ${arg_LIBRARIES})
  add_dependencies(benchmarks ${arg_NAME})
  install(TARGETS ${arg_NAME} RUNTIME DESTINATION lib/iotcloud/bench COMPONENT ${arg_NAME} EXCLUDE_FROM_ALL)
  if(arg_SMOKE)
    add_test(NAME ${arg_NAME}_runs COMMAND ${arg_NAME} ${arg_SMOKE})
    set_tests_properties(${arg_NAME}_runs PROPERTIES TIMEOUT 300)
  endif()
endfunction()

# Compiles one Thrift file of a room into the static library `iotcloud_<name>`; private to those who link it.
#   iotcloud_thrift(NAME records_idl FILE records.thrift SERVICES TMasterService USES other_idl)
# Include what it makes as "iotcloud/<room>/<file>_types.h".
function(iotcloud_thrift)
  cmake_parse_arguments(arg "" "NAME;FILE" "SERVICES;USES" ${ARGN})
  file(RELATIVE_PATH here ${PROJECT_SOURCE_DIR} ${CMAKE_CURRENT_SOURCE_DIR})
  get_filename_component(stem ${arg_FILE} NAME_WE)
  set(out ${IOTCLOUD_GENERATED_DIR}/iotcloud/${here})
  file(MAKE_DIRECTORY ${out})
  set(outputs ${out}/${stem}_types.h ${out}/${stem}_types.cpp)
  foreach(service ${arg_SERVICES})
    list(APPEND outputs ${out}/${service}.h ${out}/${service}.cpp)
  endforeach()
  add_custom_command(
    OUTPUT ${outputs}
    COMMAND ${THRIFT_COMPILER} -gen cpp:no_skeleton,include_prefix,moveable_types -I ${PROJECT_BINARY_DIR}/include
            -out ${out} ${PROJECT_BINARY_DIR}/include/iotcloud/${here}/${arg_FILE}
    DEPENDS ${CMAKE_CURRENT_SOURCE_DIR}/${arg_FILE}
    COMMENT "Thrift ${here}/${arg_FILE}" VERBATIM)
  add_library(iotcloud_${arg_NAME} STATIC ${outputs})
  list(TRANSFORM arg_USES PREPEND iotcloud_)
  target_link_libraries(iotcloud_${arg_NAME} PUBLIC PkgConfig::thrift ${arg_USES})
  target_include_directories(iotcloud_${arg_NAME} SYSTEM PUBLIC ${IOTCLOUD_GENERATED_DIR})
endfunction()
