"""The soil: slip, deformability and soil flow under each wheel, from contact angles, encoders and odometry."""
