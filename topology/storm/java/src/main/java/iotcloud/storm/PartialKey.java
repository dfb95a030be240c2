package iotcloud.storm;

import org.apache.storm.grouping.PartialKeyGrouping;
import org.apache.storm.tuple.Fields;

/** Storm's partial key grouping, made from a text: the fields of the key, a line for each. */
public class PartialKey extends PartialKeyGrouping {
  private static final long serialVersionUID = 1;

  public PartialKey(String fields) {
    super(new Fields(fields.split("\n")));
  }
}
